use crate::support::{CABLES, build, commit, entries, entries_with, hash_of};
use mcdpr_firmware::ConfigStore;
use mcdpr_protocol::{BoardKey, CableKey, ConfigEntry, ConfigHash, ConfigKey, Reject};

fn refusal(entries: &[ConfigEntry]) -> Reject {
    build(entries).expect_err("taken")
}

#[test]
fn a_whole_configuration_is_taken() {
    let active = build(&entries()).unwrap();
    assert_eq!(active.hash, hash_of(&entries()));
    assert_eq!(active.stop_ms, 300);
    assert_eq!(active.cables[3].max_current_ma, 3000);
}

#[test]
fn gains_at_a_length_become_a_share_per_length() {
    let key = ConfigKey::cable(3, CableKey::GainLength);
    // 2^40 over 0.45 m and over 2 m, in 0.1 um; at least 20 mm; 0: at any length.
    for (length, share) in [
        (4_500_000, 244_336),
        (20_000_000, 54_976),
        (1, 5_497_558),
        (0, 0),
    ] {
        let active = build(&entries_with(key, length)).unwrap();
        let got = active.cables[3].gain_per_length_q40;
        let off = f64::from(got) - f64::from(share);
        assert!(off.abs() <= 1.3e-3 * f64::from(share), "{length}: {got}");
    }
}

#[test]
fn f2_every_missing_key_is_named() {
    for missing in entries() {
        let mut all = entries();
        all.retain(|entry| entry.key != missing.key);
        let refused = refusal(&all);
        assert_eq!(refused, Reject::ConfigValue { key: missing.key.0 });
    }
}

#[test]
fn f2_every_value_out_of_its_range_is_named() {
    for ConfigEntry { key, .. } in entries() {
        for value in [i32::MIN, i32::MAX] {
            let refused = refusal(&entries_with(key, value));
            assert_eq!(refused, Reject::ConfigValue { key: key.0 }, "{value}");
        }
    }
}

#[test]
fn f2_zero_signs_and_ratios_and_contradicting_limits_are_named() {
    let cases = [
        (CableKey::EncoderSign, 0),
        (CableKey::MotorCountsPerTurn, 0),
        (CableKey::ForcePerCurrent, 0),
        (CableKey::DrumRadius, 0),
        (CableKey::Node, 0),
        // The ceiling must be above the floor and below full scale; the longest length above the
        // shortest.
        (CableKey::TensionCeiling, 500),
        (CableKey::TensionCeiling, 34_900),
        (CableKey::LengthMax, -1),
    ];
    for (key, value) in cases {
        for index in 0..CABLES as u8 {
            let key = ConfigKey::cable(index, key);
            let refused = refusal(&entries_with(key, value));
            assert_eq!(refused, Reject::ConfigValue { key: key.0 });
        }
    }
}

#[test]
fn only_bit_rates_that_the_boards_clock_gives_exactly_are_taken() {
    let key = ConfigKey::board(BoardKey::BusBitrate);
    for bits_per_s in [
        800_000, 300_000, 400_000, 999_999, 125_001, 100_000, 200_000,
    ] {
        let refused = refusal(&entries_with(key, bits_per_s));
        assert_eq!(refused, Reject::ConfigValue { key: key.0 }, "{bits_per_s}");
    }
    assert!(build(&entries_with(key, 1_000_000)).is_ok());
}

#[test]
fn a_number_that_calls_every_rmds_of_a_group_is_no_drives_own() {
    for node in [16, 32, 48, 64, 96, 112] {
        let key = ConfigKey::cable(2, CableKey::Node);
        let refused = refusal(&entries_with(key, node));
        assert_eq!(refused, Reject::ConfigValue { key: key.0 }, "{node}");
    }
    assert!(build(&entries_with(ConfigKey::cable(2, CableKey::Node), 17)).is_ok());
}

#[test]
fn another_number_of_cables_is_named() {
    let refused = refusal(&entries_with(ConfigKey::board(BoardKey::Cables), 8));
    assert_eq!(
        refused,
        Reject::CableCount {
            expected: 4,
            got: 8
        }
    );
}

#[test]
fn unknown_keys_are_named() {
    // A field, a group and a cable that do not exist.
    for key in [0x00F0, 0x04F0, 0x0501, 0x0901, 0xFFFF] {
        let mut all = entries();
        all.retain(|entry| entry.key.0 < key);
        all.pop();
        all.push(ConfigEntry {
            key: ConfigKey(key),
            value: 1,
        });
        assert_eq!(refusal(&all), Reject::ConfigUnknownKey { key });
    }
}

#[test]
fn unsorted_and_repeated_keys_are_refused() {
    let mut unsorted = entries();
    unsorted.swap(10, 11);
    assert_eq!(refusal(&unsorted), Reject::ConfigSequence);
    let mut repeated = entries();
    repeated[11] = repeated[10];
    assert_eq!(refusal(&repeated), Reject::ConfigSequence);
}

#[test]
fn none_too_many_and_too_few_entries_are_refused() {
    let mut store = ConfigStore::<CABLES>::default();
    let all = entries();
    let hash = hash_of(&all);
    assert_eq!(commit(&mut store, hash).err(), Some(Reject::ConfigSequence));
    assert_eq!(store.begin(0), Err(Reject::ConfigSequence));
    assert_eq!(
        store.begin(all.len() as u16 + 1),
        Err(Reject::ConfigSequence)
    );
    store.begin(all.len() as u16).unwrap();
    store.put(&all[..all.len() - 1]).unwrap();
    assert_eq!(commit(&mut store, hash).err(), Some(Reject::ConfigSequence));
    store.begin(3).unwrap();
    assert_eq!(store.put(&all[..4]), Err(Reject::ConfigSequence));
}

#[test]
fn f9_another_hash_is_refused_with_both() {
    let all = entries();
    let mut store = ConfigStore::<CABLES>::default();
    store.begin(all.len() as u16).unwrap();
    store.put(&all).unwrap();
    let host = ConfigHash(1);
    let board = hash_of(&all);
    assert_eq!(
        commit(&mut store, host).err(),
        Some(Reject::ConfigHash { board, host })
    );
    // The refusal changed nothing.
    assert!(commit(&mut store, board).is_ok());
}

#[test]
fn l2_one_value_changed_on_the_way_is_found_by_the_hash() {
    let host = hash_of(&entries());
    for entry in entries() {
        let all = entries_with(entry.key, entry.value ^ 1);
        let mut store = ConfigStore::<CABLES>::default();
        store.begin(all.len() as u16).unwrap();
        store.put(&all).unwrap();
        let board = hash_of(&all);
        assert_eq!(
            commit(&mut store, host).err(),
            Some(Reject::ConfigHash { board, host })
        );
    }
}

#[test]
fn a_refused_chunk_takes_none_of_its_entries() {
    let all = entries();
    for bad in [
        ConfigEntry {
            key: ConfigKey(0x00F0),
            value: 0,
        },
        all[0],
    ] {
        let mut store = ConfigStore::<CABLES>::default();
        store.begin(all.len() as u16).unwrap();
        store.put(&all[..3]).unwrap();
        assert!(store.put(&[all[3], all[4], bad]).is_err());
        // The host corrects the chunk and continues.
        store.put(&all[3..]).unwrap();
        assert!(commit(&mut store, hash_of(&all)).is_ok());
    }
}

#[test]
fn slices_leave_what_is_in_use_alone_until_all_is_good_and_end_where_the_whole_does() {
    let mut active = Some(build(&entries()).unwrap());
    let other = entries_with(ConfigKey::cable(3, CableKey::MaxCurrentMa), 2000);
    // The last cable's last key is invalid.
    let bad = entries_with(ConfigKey::cable(3, CableKey::MaxJerk), 0);
    for (all, good) in [(bad, false), (other, true)] {
        let mut store = ConfigStore::<CABLES>::default();
        store.begin(all.len() as u16).unwrap();
        store.put(&all).unwrap();
        let before = format!("{active:?}");
        let mut slices = 0;
        let result = loop {
            assert!(store.is_taking() || format!("{active:?}") == before);
            slices += 1;
            if let Some(result) = store.build_slice(hash_of(&all), &mut active) {
                break result;
            }
            assert!(slices < 100);
        };
        assert_eq!(result.is_ok(), good);
        assert!(!store.is_taking());
        if good {
            // Thirteen for the hash, six for the checks, five to take it.
            assert_eq!(slices, 24);
            let whole = build(&all).unwrap();
            assert_eq!(format!("{active:?}"), format!("{:?}", Some(whole)));
        } else {
            assert_eq!(format!("{active:?}"), before);
        }
    }
}

#[test]
fn a_drive_stops_its_drum_with_the_force_that_its_greatest_current_gives() {
    for (mass_g, current_ma, mn_per_a) in [(34_000, 500, 112_000), (2000, 3000, -50_000)] {
        let mut all = entries();
        for (key, value) in [
            (CableKey::DrumMass, mass_g),
            (CableKey::MaxCurrentMa, current_ma),
            (CableKey::ForcePerCurrent, mn_per_a),
        ] {
            let key = ConfigKey::cable(0, key);
            all.iter_mut().find(|e| e.key == key).unwrap().value = value;
        }
        let cable = build(&all).unwrap().cables[0];
        // 56 N, and 0.61 ms per mm/s; 150 N, and 0.013 ms.
        let force_n = f64::from(current_ma) * 1e-3 * f64::from(mn_per_a.abs()) * 1e-3;
        assert!((f64::from(cable.most_force_mn) * 1e-3 - force_n).abs() < 1e-3);
        let stops_s_per_mps = f64::from(mass_g) * 1e-3 / force_n;
        let found = f64::from(cable.stop_q16) / 65_536.0;
        assert!((found - stops_s_per_mps).abs() < 1e-4 * stops_s_per_mps + 2e-5);
    }
}
