//! The line to the signal board, which stands for encoders, tension sensors, switches and supply of
//! the board under test, and reads its outputs.
//!
//! Sentences of text, as instruments at sea speak (NMEA 0183): `$`, fields with commas, `*`, the
//! exclusive or of all bytes between as two hexadecimal digits, CR LF. A sentence with a wrong
//! checksum is ignored. See `docs/hil.md` for the table.

/// Channels of a board.
pub(super) const CHANNELS: usize = 4;
/// Version of the sentences.
pub(super) const VERSION: u32 = 1;
/// Longest sentence; a longer one is not one.
const LONGEST: usize = 200;

/// Input bits of the board under test.
pub(super) mod input {
    /// PB5 is high: the emergency stop is pressed, or its wire open.
    pub(in super::super) const E_STOP: u8 = 1;
    /// PA3 is high: the gripper's switch is open.
    pub(in super::super) const GRIPPER_SWITCH: u8 = 2;
    /// The board has its supply.
    pub(in super::super) const SUPPLY: u8 = 4;
    /// The supply is 2.8 V, under the threshold of the board's voltage detector.
    pub(in super::super) const SUPPLY_LOW: u8 = 8;
    /// CAN high and low are shorted.
    pub(in super::super) const CAN_SHORTED: u8 = 16;
    /// The line from the host is disturbed: its bytes arrive without a stop bit.
    pub(in super::super) const LINE_DISTURBED: u8 = 32;
}

/// Output bits of the board under test: brakes from bit 0.
pub(super) mod output {
    /// PA10 is high: the gripper closes.
    pub(in super::super) const GRIPPER: u8 = 16;
    /// PB3 is high: the drives' contactor closes.
    pub(in super::super) const DRIVE_ENABLE: u8 = 32;
}

/// Inputs for the board under test, to be reached evenly in the next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Set {
    /// Counts up with every sentence, wrapping.
    pub sequence: u32,
    /// Duration of the step, us.
    pub step_us: u32,
    /// Position of each encoder at its end, counts.
    pub encoders: [i64; CHANNELS],
    /// Voltage at each tension input, 65520 for 3.3 V.
    pub tensions: [u16; CHANNELS],
    /// Bits of [`input`].
    pub inputs: u8,
    /// Bytes sent on the board's line since the greeting, wrapping.
    pub line_bytes: u32,
    /// Frames sent on the bus since the greeting, wrapping.
    pub can_frames: u32,
}

/// Outputs of the board under test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Got {
    /// The sentence that it answers.
    pub sequence: u32,
    /// Bits of [`output`].
    pub outputs: u8,
    /// Bytes that the board has sent on its line since the greeting, where time is stepped.
    pub line_bytes: u32,
    /// Frames that it has sent, likewise.
    pub can_frames: u32,
}

/// A sentence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sentence {
    /// To the signal board: who are you. It switches the board under test off and on, if it can.
    Hello,
    /// Its answer: version, and whether the board's time passes only by [`Set::step_us`].
    Here { version: u32, stepped: bool },
    /// To the signal board.
    Set(Set),
    /// From it.
    Got(Got),
}

fn checksum(body: &str) -> u8 {
    body.bytes().fold(0, |sum, byte| sum ^ byte)
}

impl Sentence {
    pub(super) fn to_text(self) -> String {
        let body = match self {
            Self::Hello => "HELLO".to_owned(),
            Self::Here { version, stepped } => {
                let time = if stepped { "STEPPED" } else { "FREE" };
                format!("HERE,{version},{time}")
            }
            Self::Set(set) => {
                let [a, b, c, d] = set.encoders;
                let [e, f, g, h] = set.tensions;
                format!(
                    "SET,{},{},{a},{b},{c},{d},{e},{f},{g},{h},{:X},{},{}",
                    set.sequence, set.step_us, set.inputs, set.line_bytes, set.can_frames
                )
            }
            Self::Got(got) => format!(
                "GOT,{},{:X},{},{}",
                got.sequence, got.outputs, got.line_bytes, got.can_frames
            ),
        };
        format!("${body}*{:02X}\r\n", checksum(&body))
    }

    /// `None` for what is no sentence.
    pub(super) fn parse(line: &str) -> Option<Self> {
        let (body, sum) = line.trim_end().strip_prefix('$')?.split_once('*')?;
        if sum.len() != 2 || u8::from_str_radix(sum, 16).ok()? != checksum(body) {
            return None;
        }
        let mut fields = body.split(',');
        let kind = fields.next()?;
        let rest: Vec<&str> = fields.collect();
        match (kind, rest.as_slice()) {
            ("HELLO", []) => Some(Self::Hello),
            ("HERE", [version, time]) => Some(Self::Here {
                version: version.parse().ok()?,
                stepped: match *time {
                    "STEPPED" => true,
                    "FREE" => false,
                    _ => return None,
                },
            }),
            (
                "SET",
                [
                    sequence,
                    step,
                    a,
                    b,
                    c,
                    d,
                    e,
                    f,
                    g,
                    h,
                    inputs,
                    bytes,
                    frames,
                ],
            ) => Some(Self::Set(Set {
                sequence: sequence.parse().ok()?,
                step_us: step.parse().ok()?,
                encoders: all([a, b, c, d])?,
                tensions: all([e, f, g, h])?,
                inputs: u8::from_str_radix(inputs, 16).ok()?,
                line_bytes: bytes.parse().ok()?,
                can_frames: frames.parse().ok()?,
            })),
            ("GOT", [sequence, outputs, bytes, frames]) => Some(Self::Got(Got {
                sequence: sequence.parse().ok()?,
                outputs: u8::from_str_radix(outputs, 16).ok()?,
                line_bytes: bytes.parse().ok()?,
                can_frames: frames.parse().ok()?,
            })),
            _ => None,
        }
    }
}

fn all<T: std::str::FromStr + Copy + Default>(texts: [&str; CHANNELS]) -> Option<[T; CHANNELS]> {
    let mut values = [T::default(); CHANNELS];
    for (value, text) in values.iter_mut().zip(texts) {
        *value = text.parse().ok()?;
    }
    Some(values)
}

/// Takes the complete lines, up to CR or LF, out of what has arrived.
pub(super) fn take_lines(bytes: &mut Vec<u8>) -> Vec<String> {
    let ends = |byte: &u8| matches!(byte, b'\r' | b'\n');
    let mut lines = Vec::new();
    while let Some(end) = bytes.iter().position(ends) {
        let line: Vec<u8> = bytes.drain(..=end).collect();
        let text = String::from_utf8_lossy(line.get(..end).unwrap_or_default());
        if !text.is_empty() {
            lines.push(text.into_owned());
        }
    }
    // Noise without an end must not fill the memory.
    if bytes.len() > LONGEST {
        bytes.clear();
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_come_back_as_they_were() {
        let set = Set {
            sequence: u32::MAX,
            step_us: 250,
            encoders: [-5, 0, 70_000, i64::from(i32::MIN)],
            tensions: [0, 1, 65_520, 32_000],
            inputs: input::SUPPLY | input::CAN_SHORTED,
            line_bytes: 17,
            can_frames: 4,
        };
        let got = Got {
            sequence: 9,
            outputs: 0x2F,
            line_bytes: 1,
            can_frames: 2,
        };
        let here = |stepped| Sentence::Here {
            version: VERSION,
            stepped,
        };
        let all = [
            Sentence::Hello,
            here(true),
            here(false),
            Sentence::Set(set),
            Sentence::Got(got),
        ];
        for sentence in all {
            assert_eq!(Sentence::parse(&sentence.to_text()), Some(sentence));
        }
        // By hand: H ^ E ^ L ^ L ^ O.
        assert_eq!(Sentence::Hello.to_text(), "$HELLO*42\r\n");
    }

    #[test]
    fn a_damaged_sentence_is_none() {
        let text = Sentence::Got(Got::default()).to_text();
        for place in 0..text.trim_end().len() {
            let mut bytes = text.clone().into_bytes();
            bytes[place] ^= 1;
            let damaged = String::from_utf8(bytes).unwrap();
            assert_eq!(Sentence::parse(&damaged), None, "{damaged}");
        }
        for bad in ["", "$", "$*00", "$SET,1*00", "$HELLO", "HELLO*42"] {
            assert_eq!(Sentence::parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn lines_are_taken_whole_and_noise_is_dropped() {
        let mut bytes = b"one\r\n\rtwo\nthr".to_vec();
        assert_eq!(take_lines(&mut bytes), ["one", "two"]);
        assert_eq!(bytes, b"thr");
        bytes.extend([b'x'; 300]);
        assert!(take_lines(&mut bytes).is_empty() && bytes.is_empty());
    }
}
