//! Replays an independent core's results for random instructions (tests/data/generate.py).

use super::decode::decode;
use super::tests::bus;
use super::{Cpu, Trap};
use crate::bus::{FLASH, RAM};

const CASES: &str = include_str!("../../tests/data/cases.txt");
/// Words of RAM that a case may change.
const WORDS: u32 = 0x100;

/// As `value` of the generator.
fn value(seed: u32, index: u32) -> u32 {
    let mut x = seed
        .wrapping_mul(0x9E37_79B9)
        .wrapping_add(index.wrapping_mul(0x85EB_CA6B))
        .wrapping_add(0x0123_4567);
    x = (x ^ (x >> 16)).wrapping_mul(0x7FEB_352D);
    x = (x ^ (x >> 15)).wrapping_mul(0x846C_A68B);
    x ^= x >> 16;
    match x >> 8 & 31 {
        0 => 0,
        1 => 1,
        2 => u32::MAX,
        3 => 0x8000_0000,
        4 => 0x7FFF_FFFF,
        5 => x & 31,
        6 => x & 255,
        7 => x | 0xFFFF_0000,
        _ => x,
    }
}

fn hex(text: &str) -> u32 {
    u32::from_str_radix(text, 16).expect("hexadecimal in the recorded file")
}

fn pair(text: &str) -> (&str, u32) {
    let (name, value) = text.split_once('=').expect("name=value");
    (name, hex(value))
}

/// What differs, if anything.
fn replay(line: &str) -> Result<(), String> {
    let (before, after) = line.split_once(" > ").expect("a `>` per line");
    let mut before = before.split(' ').skip(1);
    let mut next = || before.next().expect("seed, address, flags, code");
    let (seed, address, flags, code) = (hex(next()), hex(next()), hex(next()), next());
    let mut bus = bus();
    let at = (address - FLASH) as usize;
    for index in (0..code.len()).step_by(2) {
        bus.flash[at + index / 2] = hex(&code[index..index + 2]) as u8;
    }
    let end = address + (code.len() / 2) as u32;
    let mut cpu = Cpu::new(RAM + 0x200, address);
    for index in 0..15 {
        cpu.regs[index as usize] = value(seed, index);
    }
    cpu.regs[13] = RAM + 0x200;
    for given in before {
        let (name, value) = pair(given);
        cpu.regs[hex(name) as usize] = value;
    }
    cpu.set_apsr(flags << 27);
    for word in 0..WORDS {
        let filled = bus.write(RAM + 4 * word, 4, value(seed, 16 + word));
        assert_eq!(filled, Ok(()));
    }
    let mut registers = cpu.regs;
    let mut memory = bus.ram.clone();
    for _ in 0..12 {
        if cpu.pc == end {
            break;
        }
        let half = |bus: &mut crate::bus::Bus, at| bus.read(at, 2).map(|half| half as u16);
        let mut run = || -> Result<(), Trap> {
            let (first, second) = (half(&mut bus, cpu.pc)?, half(&mut bus, cpu.pc + 2)?);
            let (op, length) = decode(cpu.pc, first, second);
            cpu.step(&mut bus, op, u32::from(length)).map(drop)
        };
        run().map_err(|trap| format!("{trap:?} at {:#x}", cpu.pc))?;
    }
    let mut after = after.split(' ');
    let expected_flags = hex(after.next().unwrap_or(""));
    for change in after {
        let (name, value) = pair(change);
        if let Some(offset) = name.strip_prefix('@') {
            let offset = hex(offset) as usize;
            memory[offset..offset + 4].copy_from_slice(&value.to_le_bytes());
        } else {
            registers[hex(name) as usize] = value;
        }
    }
    for (index, (got, want)) in cpu.regs.iter().zip(&registers).take(15).enumerate() {
        if got != want {
            return Err(format!("r{index} is {got:#x}, not {want:#x}"));
        }
    }
    if cpu.apsr() >> 27 != expected_flags {
        return Err(format!(
            "flags are {:x}, not {expected_flags:x}",
            cpu.apsr() >> 27
        ));
    }
    if bus.ram != memory {
        return Err("RAM differs".to_owned());
    }
    Ok(())
}

#[test]
fn agrees_with_an_independent_core() {
    let failures: Vec<String> = CASES
        .lines()
        .filter_map(|line| replay(line).err().map(|error| format!("{line}: {error}")))
        .collect();
    assert_eq!(CASES.lines().count(), 5000);
    assert!(
        failures.is_empty(),
        "{} cases differ:\n{}",
        failures.len(),
        failures[..failures.len().min(40)].join("\n")
    );
}
