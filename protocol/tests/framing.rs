//! Frames over a bad line: only damaged frames are lost, and no false one is accepted.
//!
//! Seeded and bounded: the same cases in every run, a few seconds in all.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    missing_docs
)]

mod common;

use common::{Encoded, hello, list, messages};
use mcdpr_protocol::frame::{MAX_BODY, MAX_FRAME, encode_bytes, encode_frame};
use mcdpr_protocol::message::{CONFIG_CHUNK, decode};
use mcdpr_protocol::*;
use postcard::experimental::max_size::MaxSize;
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

fn seeded(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(0x6D63_6470),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

type Frames = Vec<Result<(Channel, Vec<u8>), FrameError>>;

fn receive(deframer: &mut Deframer, bytes: &[u8]) -> Frames {
    let each = |byte: &u8| {
        deframer
            .push(*byte)
            .map(|r| r.map(|(c, body)| (c, body.to_vec())))
    };
    bytes.iter().filter_map(each).collect()
}

fn whole(bytes: &[u8]) -> Frames {
    receive(&mut Deframer::new(), bytes)
}

fn framed(channel: Channel, body: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let used = encode_bytes(channel, body, &mut out).unwrap();
    out[..used].to_vec()
}

fn channel() -> impl Strategy<Value = Channel> {
    prop::sample::select(vec![
        Channel::HelloQuery,
        Channel::Hello,
        Channel::Command,
        Channel::Answer,
        Channel::Samples,
        Channel::Status,
    ])
}

fn body() -> impl Strategy<Value = Vec<u8>> {
    // Zeros and long runs without zeros are the cases that COBS treats differently.
    prop_oneof![
        vec(any::<u8>(), 0..=MAX_BODY),
        vec(1..=255_u8, 200..=MAX_BODY),
        vec(prop::sample::select(vec![0_u8, 1, 255]), 0..=MAX_BODY),
    ]
}

fn wide() -> impl Strategy<Value = i32> {
    prop_oneof![any::<i32>(), -100..100_i32, Just(i32::MIN), Just(i32::MAX)]
}

fn per_cable<T: std::fmt::Debug + Clone>(
    of: impl Strategy<Value = T>,
) -> impl Strategy<Value = PerCable<T>> {
    vec(of, 0..=MAX_CABLES).prop_map(list)
}

fn knot() -> impl Strategy<Value = Knot> {
    let cable = (wide(), wide(), wide()).prop_map(|(length, velocity, tension)| CableKnot {
        length: TenthMicrometres(length),
        velocity: MicrometresPerSecond(velocity),
        tension: Millinewtons(tension),
    });
    let coefficients = || per_cable(any::<i16>().prop_map(Coefficient));
    let row = (coefficients(), coefficients(), wide()).prop_map(|(lengths, tensions, limit)| {
        ResidualRow {
            lengths,
            tensions,
            limit: Micrometres(limit),
        }
    });
    (
        any::<u16>(),
        any::<u32>(),
        any::<bool>(),
        per_cable(cable),
        vec(row, 0..=ResidualRow::PER_KNOT),
    )
        .prop_map(|(index, time_ms, last, cables, rows)| Knot {
            index,
            time_ms,
            last,
            cables,
            rows: list(rows),
        })
}

fn request() -> impl Strategy<Value = Request> {
    let entry = (any::<u16>(), wide()).prop_map(|(key, value)| ConfigEntry {
        key: ConfigKey(key),
        value,
    });
    let lengths = per_cable(wide().prop_map(TenthMicrometres));
    let tensions = per_cable(wide().prop_map(Millinewtons));
    prop_oneof![
        Just(Request::Info),
        Just(Request::Stop(StopKind::Emergency)),
        any::<u32>().prop_map(|host_time_us| Request::Heartbeat { host_time_us }),
        any::<u16>().prop_map(|entries| Request::ConfigBegin { entries }),
        vec(entry, 0..=CONFIG_CHUNK).prop_map(|entries| Request::ConfigPut {
            entries: list(entries)
        }),
        any::<u32>().prop_map(|hash| Request::ConfigCommit {
            hash: ConfigHash(hash)
        }),
        (lengths, tensions)
            .prop_map(|(lengths, tensions)| Request::Reference { lengths, tensions }),
        any::<u32>().prop_map(|hash| Request::Arm {
            config_hash: ConfigHash(hash)
        }),
        knot().prop_map(Request::Knot),
        any::<bool>().prop_map(|enabled| Request::Samples { enabled }),
    ]
}

fn command() -> impl Strategy<Value = Command> {
    (any::<u32>(), any::<u16>(), request()).prop_map(|(session, sequence, request)| Command {
        session: SessionId(session),
        sequence: SequenceNumber(sequence),
        request,
    })
}

/// What kept frames a stream gives, in order.
fn accepted(frames: Frames) -> Vec<(Channel, Vec<u8>)> {
    frames.into_iter().filter_map(Result::ok).collect()
}

/// Bytes that cannot hold a frame with a valid checksum, for sure: all alike.
fn garbage() -> impl Strategy<Value = Vec<u8>> {
    (1..=255_u8, 0..700_usize).prop_map(|(byte, count)| vec![byte; count])
}

proptest! {
    #![proptest_config(seeded(2000))]

    #[test]
    fn any_body_comes_through_whole_however_it_is_chunked(
        frames in vec((channel(), body()), 1..6),
        cuts in vec(1..40_usize, 1..40),
    ) {
        let stream: Vec<u8> = frames.iter().flat_map(|(c, b)| framed(*c, b)).collect();
        let mut deframer = Deframer::new();
        let (mut got, mut rest) = (vec![], stream.as_slice());
        for cut in cuts.iter().cycle() {
            let (chunk, tail) = rest.split_at((*cut).min(rest.len()));
            got.extend(receive(&mut deframer, chunk));
            rest = tail;
            if rest.is_empty() {
                break;
            }
        }
        let expected: Frames = frames.into_iter().map(Ok).collect();
        prop_assert_eq!(got, expected);
    }

    #[test]
    fn a_frame_is_at_most_256_bytes_and_has_one_zero(c in channel(), b in body()) {
        let bytes = framed(c, &b);
        prop_assert!(bytes.len() <= MAX_FRAME);
        prop_assert_eq!(bytes.iter().position(|byte| *byte == 0), Some(bytes.len() - 1));
    }

    #[test]
    fn l6_l8_garbage_before_after_and_between_costs_at_most_the_frame_it_touches(
        frames in vec((channel(), body()), 2..5),
        noise in vec(garbage(), 5),
    ) {
        // Between delimiters: nothing is lost.
        let mut stream = vec![];
        for ((c, b), noise) in frames.iter().zip(&noise) {
            stream.extend_from_slice(noise);
            stream.push(0);
            stream.extend(framed(*c, b));
        }
        prop_assert_eq!(&accepted(whole(&stream)), &frames);
        // Appended to a frame: that one is lost, the others are not.
        let mut stream = vec![0x55];
        stream.extend_from_slice(&noise[0]);
        for (c, b) in &frames {
            stream.extend(framed(*c, b));
        }
        stream.extend_from_slice(&noise[1]);
        prop_assert_eq!(&accepted(whole(&stream)), &frames[1..]);
    }

    #[test]
    fn l6_a_truncated_frame_is_lost_alone(
        first in (channel(), body()),
        second in (channel(), body()),
        cut in any::<prop::sample::Index>(),
    ) {
        let bytes = framed(first.0, &first.1);
        let kept = cut.index(bytes.len() - 1);
        // Its end is missing, the delimiter is not.
        let mut stream = bytes[..kept].to_vec();
        stream.push(0);
        stream.extend(framed(second.0, &second.1));
        prop_assert_eq!(accepted(whole(&stream)), vec![second.clone()]);
        // Its start is missing.
        let mut stream = bytes[kept + 1..].to_vec();
        stream.extend(framed(second.0, &second.1));
        prop_assert_eq!(accepted(whole(&stream)), vec![second]);
    }

    #[test]
    fn l1_flipped_bits_are_never_taken_for_another_message(
        c in channel(),
        b in body(),
        flips in vec(any::<prop::sample::Index>(), 1..24),
    ) {
        let mut bytes = framed(c, &b);
        for flip in flips {
            let bit = flip.index(bytes.len() * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        bytes.push(0);
        for (channel, body) in accepted(whole(&bytes)) {
            // Flips that undo each other leave the message itself.
            prop_assert_eq!((channel, &body), (c, &b));
        }
    }

    #[test]
    fn commands_come_back_as_they_were(command in command()) {
        let mut out = [0; MAX_FRAME];
        let used = encode_frame(Channel::Command, &command, &mut out).unwrap();
        let frames = accepted(whole(&out[..used]));
        prop_assert_eq!(frames.len(), 1);
        prop_assert_eq!(decode::<Command>(&frames[0].1), Some(command.clone()));
        // Neither a byte more nor a byte less decodes to the same message.
        let body = &frames[0].1;
        let longer: Vec<u8> = body.iter().copied().chain([0]).collect();
        prop_assert_eq!(decode::<Command>(&longer), None);
        prop_assert_eq!(decode::<Command>(&body[..body.len() - 1]), None);
    }

    #[test]
    fn samples_unpack_to_what_was_appended(
        cables in 1..=MAX_CABLES,
        rows in vec(vec((-32_768..=32_767_i32, -50_000..=600_000_i32, any::<i16>()), MAX_CABLES), 10),
    ) {
        let start: Vec<_> = (0..cables as i32).map(|k| TenthMicrometres(k * 1_000_000)).collect();
        let mut block = SampleBlock {
            lengths: list(start.iter().copied()),
            tick: Tick(u32::MAX - 3),
            ..SampleBlock::default()
        };
        let (mut previous, mut truth) = (start, vec![]);
        for (position, row) in rows.iter().take(SampleBlock::ticks(cables)).enumerate() {
            let samples: Vec<_> = previous.iter().zip(row).map(|(before, values)| Sample {
                length: TenthMicrometres(before.0 + values.0),
                tension: Millinewtons(values.1),
                current: Milliamps(i32::from(values.2)),
            }).collect();
            prop_assert!(block.append(position, &previous, &samples), "no room at {}", position);
            previous = samples.iter().map(|sample| sample.length).collect();
            truth.push(samples);
        }
        let (mut ticks, mut got) = (vec![], vec![]);
        block.unpack(|tick, row| {
            ticks.push(tick);
            got.push(row.to_vec());
        });
        prop_assert_eq!(got.len(), SampleBlock::ticks(cables));
        for (position, row) in got.iter().enumerate() {
            prop_assert_eq!(ticks[position], Tick(u32::MAX - 3).after(position as u32));
            for (cable, sample) in row.iter().enumerate() {
                let even = &truth[position - position % 2][cable];
                let true_mn = truth[position][cable].tension.0.clamp(0, 557_040);
                // One millinewton up to 32.768 N, steps of 16 above.
                let off_mn = true_mn - sample.tension.0;
                let step_mn = if true_mn > 32_768 { 16 } else { 1 };
                prop_assert!((0..step_mn).contains(&off_mn));
                let expected = Sample { current: even.current, tension: sample.tension, ..truth[position][cable] };
                prop_assert_eq!(*sample, expected);
            }
        }
        prop_assert!(Encoded::of(&block).body <= MAX_BODY);
    }
}

proptest! {
    #![proptest_config(seeded(200_000))]

    #[test]
    fn l2_l8_any_body_with_a_valid_checksum_decodes_or_is_refused_without_panic(
        b in prop_oneof![
            vec(any::<u8>(), 0..=MAX_BODY),
            vec(any::<u8>(), 0..40),
            // Bodies that begin as messages do.
            (0..24_u8, vec(any::<u8>(), 0..60)).prop_map(|(variant, rest)| {
                let head = [1, 0, variant];
                head.into_iter().chain(rest).collect::<Vec<u8>>()
            }),
        ],
    ) {
        let frames = accepted(whole(&framed(Channel::Command, &b)));
        prop_assert_eq!(&frames[0].1, &b);
        if let Some(command) = decode::<Command>(&b) {
            // An accepted message can be encoded again.
            prop_assert!(Encoded::of(&command).body <= Command::POSTCARD_MAX_SIZE);
        }
        let _ = decode::<Answer>(&b);
        let _ = decode::<Status>(&b);
        let _ = Hello::from_bytes(&b);
        if let Some(block) = decode::<SampleBlock>(&b) {
            let mut rows = 0_usize;
            block.unpack(|_, row| {
                rows += 1;
                assert_eq!(row.len(), block.lengths.len());
            });
            prop_assert!(rows * block.lengths.len() * 4 <= block.packed.len());
        }
    }
}

#[test]
fn l1_no_single_bit_flip_of_any_message_is_taken() {
    for (name, message) in messages() {
        let frame = message.frame();
        let sent = accepted(whole(&frame));
        for bit in 0..frame.len() * 8 {
            let mut flipped = frame.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            flipped.push(0);
            assert_eq!(accepted(whole(&flipped)), vec![], "{name}, bit {bit}");
        }
        assert_eq!(sent.len(), 1);
    }
}

#[test]
fn l1_no_two_flipped_bits_of_a_short_frame_are_taken() {
    let frame = framed(Channel::Command, b"stop");
    let bits = frame.len() * 8;
    for first in 0..bits {
        for second in first + 1..bits {
            let mut flipped = frame.clone();
            flipped[first / 8] ^= 1 << (first % 8);
            flipped[second / 8] ^= 1 << (second % 8);
            flipped.push(0);
            assert_eq!(
                accepted(whole(&flipped)),
                vec![],
                "bits {first} and {second}"
            );
        }
    }
}

#[test]
fn l7_bytes_without_end_are_refused_once_and_the_next_frame_comes_through() {
    for count in [255, 256, 257, 1000, 100_000] {
        let mut stream = vec![0x7F; count];
        stream.push(0);
        stream.extend(framed(Channel::HelloQuery, &[]));
        let frames = whole(&stream);
        assert_eq!(frames.len(), 2, "{count}");
        let error = frames[0].as_ref().err().copied();
        if count > MAX_FRAME - 1 {
            assert_eq!(error, Some(FrameError::TooLong));
        } else {
            assert!(error.is_some());
        }
        assert_eq!(frames[1], Ok((Channel::HelloQuery, vec![])));
    }
}

#[test]
fn l6_too_short_and_empty_frames_are_distinguished() {
    // Delimiters alone are no frames; fewer bytes than a channel and a checksum are no frame.
    assert_eq!(whole(&[0, 0, 0]), vec![]);
    assert_eq!(whole(&[1, 0]), vec![Err(FrameError::Malformed)]);
    assert_eq!(whole(&[5, 1, 2, 3, 4, 0]), vec![Err(FrameError::Checksum)]);
    assert_eq!(whole(&[9, 1, 2, 0]), vec![Err(FrameError::Malformed)]);
    // The checksum of nothing is 0: four zeros are a checksum without a channel.
    assert_eq!(whole(&[1, 1, 1, 1, 1, 0]), vec![Err(FrameError::Malformed)]);
}

#[test]
fn bodies_of_every_length_fit_up_to_the_largest_and_none_beyond() {
    for fill in [0_u8, 1, 0x10, 255] {
        for length in 0..=MAX_BODY {
            let body = vec![fill; length];
            let frames = whole(&framed(Channel::Status, &body));
            assert_eq!(
                frames,
                vec![Ok((Channel::Status, body))],
                "{fill} x {length}"
            );
        }
        let mut out = [0; MAX_FRAME];
        for length in [MAX_BODY + 1, 300, 5000] {
            let result = encode_bytes(Channel::Status, &vec![fill; length], &mut out);
            assert_eq!(result, Err(FrameError::Encode));
        }
    }
}

#[test]
fn a_full_block_refuses_more_and_a_damaged_one_ends_early() {
    let mut block = common::samples();
    let row = [Sample::default(); 4];
    let previous = [TenthMicrometres(0); 4];
    for position in 2..10 {
        assert!(block.append(position, &previous, &row));
    }
    assert!(!block.append(10, &previous, &row));
    let mut short = common::samples();
    short.packed = list(short.packed.iter().copied().take(30));
    let mut ticks = 0;
    short.unpack(|_, _| ticks += 1);
    assert_eq!(ticks, 1);
    assert_eq!(hello().to_bytes().len(), Hello::SIZE);
}

#[test]
fn sequence_numbers_and_ticks_count_across_their_wraps() {
    let number = SequenceNumber;
    assert_eq!(number(65_535).next(), number(0));
    assert_eq!(number(3).since(number(65_533)), 6);
    assert_eq!(number(65_533).since(number(3)), -6);
    assert_eq!(Tick(5).since(Tick(u32::MAX - 4)), 10);
    assert_eq!(Tick(u32::MAX).after(1), Tick(0));
}

#[test]
fn the_checksum_is_what_an_independent_one_says() {
    let judge = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    for length in 0..300_u32 {
        let bytes: Vec<u8> = (0..length)
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect();
        assert_eq!(mcdpr_protocol::frame::crc32(&bytes), judge.checksum(&bytes));
    }
}
