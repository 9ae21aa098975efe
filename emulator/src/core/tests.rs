//! Cases that random sequences do not reach: branches, tables, exceptions, masks, sleep. Expected
//! values are worked out by hand from the architecture manual.

use super::decode::decode;
use super::op::Op;
use super::{Cpu, Switch, Trap};
use crate::bus::{Bus, FLASH, FLASH_BYTES, RAM, RAM_BYTES};
use crate::scs::{FIRST_IRQ, SVC};

const STACK: u32 = RAM + 0x1000;
const CODE: u32 = FLASH + 0x400;
const HANDLER: u32 = FLASH + 0x800;

/// Memory without a program.
pub(super) fn bus() -> Bus {
    let flash = vec![0xBF; FLASH_BYTES as usize];
    Bus::new(flash, vec![0; RAM_BYTES as usize], 0, 0)
}

/// A core about to execute `code`, every vector at `HANDLER`, interrupt `n` at priority 16 `n`.
fn machine(code: &[u16]) -> (Cpu, Bus) {
    let mut bus = bus();
    place(&mut bus, CODE, code);
    for vector in 0..64 {
        let target = HANDLER + 1;
        place(
            &mut bus,
            FLASH + 4 * vector,
            &[target as u16, (target >> 16) as u16],
        );
    }
    for n in 0..16 {
        let written = bus.write(0xE000_E400 + n, 1, 16 * n);
        assert_eq!(written, Ok(()));
    }
    assert_eq!(bus.write(0xE000_E100, 4, 0xFFFF), Ok(()));
    (Cpu::new(STACK, CODE + 1), bus)
}

fn place(bus: &mut Bus, at: u32, code: &[u16]) {
    for (index, half) in code.iter().enumerate() {
        let at = (at - FLASH) as usize + 2 * index;
        bus.flash[at..at + 2].copy_from_slice(&half.to_le_bytes());
    }
}

fn step(cpu: &mut Cpu, bus: &mut Bus) -> Result<u64, Trap> {
    let first = bus.read(cpu.pc, 2)? as u16;
    let second = bus.read(cpu.pc + 2, 2)? as u16;
    let (op, length) = decode(cpu.pc, first, second);
    cpu.step(bus, op, u32::from(length))
}

fn steps(cpu: &mut Cpu, bus: &mut Bus, count: usize) {
    for _ in 0..count {
        let done = step(cpu, bus);
        assert!(done.is_ok(), "{done:?} at {:#x}", cpu.pc);
    }
}

#[test]
fn table_branches_jump_by_twice_the_entry() {
    // tbb [pc, r0]; entries 2 and 5: pc + 4 + 2 * 5.
    let (mut cpu, mut bus) = machine(&[0xE8DF, 0xF000, 0x0502]);
    cpu.regs[0] = 1;
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 4 + 10);
    // tbh [pc, r0, lsl #1] with 0x0100 as second entry.
    let (mut cpu, mut bus) = machine(&[0xE8DF, 0xF010, 0x0002, 0x0100]);
    cpu.regs[0] = 1;
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 4 + 0x200);
}

#[test]
fn calls_keep_the_way_back() {
    // bl .+0x1004 (imm 0x1000); then bx lr comes back.
    let (mut cpu, mut bus) = machine(&[0xF001, 0xF800]);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.pc, cpu.regs[14]), (CODE + 0x1004, CODE + 5));
    place(&mut bus, CODE + 0x1004, &[0x4770]);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 4);
    // blx r3
    let (mut cpu, mut bus) = machine(&[0x4798]);
    cpu.regs[3] = HANDLER | 1;
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.pc, cpu.regs[14]), (HANDLER, CODE + 3));
}

#[test]
fn jumps_go_where_they_say() {
    // b .+6; b.w .+12; blx r3; bx lr comes back behind it.
    let (mut cpu, mut bus) = machine(&[0xE001]);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 6);
    let (mut cpu, mut bus) = machine(&[0xF000, 0xB804]);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 12);
    let (mut cpu, mut bus) = machine(&[0x4798]);
    place(&mut bus, CODE + 0x40, &[0x4770]);
    cpu.regs[3] = CODE + 0x41;
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.pc, cpu.regs[14]), (CODE + 0x40, CODE + 3));
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.pc, CODE + 2);
}

#[test]
fn shifts_that_leave_the_flags() {
    // lsr.w r0, r1, #4; rrx r2, r3; sub sp, #8; nop.w.
    let (mut cpu, mut bus) = machine(&[0xEA4F, 0x1011, 0xEA4F, 0x0233, 0xB082, 0xF3AF, 0x8000]);
    cpu.set_apsr(1 << 29);
    (cpu.regs[1], cpu.regs[3]) = (0x8000_0010, 2);
    steps(&mut cpu, &mut bus, 4);
    assert_eq!((cpu.regs[0], cpu.regs[2]), (0x0800_0001, 0x8000_0001));
    assert_eq!((cpu.regs[13], cpu.pc), (STACK - 8, CODE + 14));
    assert_eq!(cpu.apsr(), 1 << 29);
}

#[test]
fn loads_and_stores_move_their_base_before_or_after() {
    // ldrh r4, [r5], #2; strb r4, [r5], #1; str r4, [r5, #4]!; ldr r0, [r1, r2].
    let code = [0xF835, 0x4B02, 0xF805, 0x4B01, 0xF845, 0x4F04, 0x5888];
    let (mut cpu, mut bus) = machine(&code);
    assert_eq!(bus.write(RAM, 4, 0x1234_5678), Ok(()));
    cpu.regs[5] = RAM;
    (cpu.regs[1], cpu.regs[2]) = (RAM - 8, 8);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.regs[4], cpu.regs[5]), (0x5678, RAM + 2));
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.regs[5], RAM + 3);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.regs[5], RAM + 7);
    assert_eq!(bus.read(RAM + 7, 4), Ok(0x5678));
    steps(&mut cpu, &mut bus, 1);
    // The byte went into the third place, the word from the eighth on.
    assert_eq!(cpu.regs[0], 0x1278_5678);
}

#[test]
fn literals_are_counted_from_the_next_word() {
    // ldr r0, [pc, #4] at a multiple of four, and ldr.w r1, [pc, #8] behind it.
    let code = [
        0x4801, 0xF8DF, 0x1008, 0xBF00, 0x3344, 0x1122, 0x7788, 0x5566,
    ];
    let (mut cpu, mut bus) = machine(&code);
    steps(&mut cpu, &mut bus, 2);
    assert_eq!((cpu.regs[0], cpu.regs[1]), (0x1122_3344, 0x5566_7788));
}

#[test]
fn a_branch_without_the_thumb_bit_is_refused() {
    let (mut cpu, mut bus) = machine(&[0x4718]);
    cpu.regs[3] = HANDLER;
    let refused = Err(Trap::State { address: HANDLER });
    assert_eq!(step(&mut cpu, &mut bus), refused);
    assert_eq!(cpu.pc, CODE, "the fault is at the branch");
}

#[test]
fn pushed_registers_come_back_and_pop_branches() {
    // push {r4, lr}; movs r4, #1; pop {r4, pc}
    let (mut cpu, mut bus) = machine(&[0xB510, 0x2401, 0xBD10]);
    cpu.regs[4] = 77;
    cpu.regs[14] = HANDLER | 1;
    steps(&mut cpu, &mut bus, 2);
    assert_eq!((cpu.regs[13], cpu.regs[4]), (STACK - 8, 1));
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.regs[13], cpu.regs[4], cpu.pc), (STACK, 77, HANDLER));
    assert_eq!(cpu.lowest_sp, STACK - 8);
}

#[test]
fn multiple_and_exclusive_access_must_be_aligned_but_words_need_not() {
    let at = RAM + 0x101;
    for code in [[0xC8FC, 0xBF00], [0xE950, 0x1200], [0xE850, 0x1F00]] {
        let (mut cpu, mut bus) = machine(&code);
        cpu.regs[0] = at;
        let trap = step(&mut cpu, &mut bus);
        assert_eq!(trap, Err(Trap::Unaligned { address: at }));
    }
    let (mut cpu, mut bus) = machine(&[0x6801]);
    assert_eq!(bus.write(at, 4, 0x1234_5678), Ok(()));
    cpu.regs[0] = at;
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.regs[1], 0x1234_5678);
}

#[test]
fn what_this_core_lacks_is_undefined() {
    // UDF, SXTAB (DSP), VMOV (coprocessor), UMAAL (DSP), SSAT16 (DSP), POP to SP.
    for (first, second) in [
        (0xDE00, 0),
        (0xFA40, 0xF080),
        (0xEE00, 0x0A10),
        (0xFBE0, 0x1060),
        (0xF320, 0x0000),
        (0xE8BD, 0xA000),
    ] {
        assert_eq!(decode(CODE, first, second).0, Op::Undefined, "{first:x}");
    }
}

#[test]
fn an_exception_stacks_and_returns() {
    // Thread: movs r0, #5; movs r0, #6. Handler: movs r0, #9; bx lr.
    let (mut cpu, mut bus) = machine(&[0x2005, 0x2006]);
    place(&mut bus, HANDLER, &[0x2009, 0x4770]);
    cpu.regs[13] = STACK - 4;
    steps(&mut cpu, &mut bus, 1);
    cpu.c = true;
    bus.scs.pend_irq(3);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!(cpu.ipsr, FIRST_IRQ + 3);
    assert_eq!(cpu.regs[14], 0xFFFF_FFF9);
    // Aligned to eight bytes: 4 of padding, noted in bit 9 of the stacked xPSR.
    assert_eq!(cpu.regs[13], STACK - 40);
    assert_eq!(bus.read(STACK - 40, 4), Ok(5));
    assert_eq!(bus.read(STACK - 40 + 24, 4), Ok(CODE + 2));
    assert_eq!(bus.read(STACK - 40 + 28, 4), Ok(0x2100_0200));
    cpu.c = false;
    steps(&mut cpu, &mut bus, 2);
    assert_eq!(cpu.switched, Some(Switch::Leave(FIRST_IRQ + 3)));
    assert_eq!((cpu.pc, cpu.regs[0], cpu.ipsr), (CODE + 2, 5, 0));
    assert_eq!((cpu.regs[13], cpu.c), (STACK - 4, true));
}

#[test]
fn priorities_decide_who_preempts() {
    let (mut cpu, mut bus) = machine(&[0xBF00]);
    bus.scs.pend_irq(5);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    bus.scs.pend_irq(9);
    assert_eq!(cpu.take_exception(&mut bus), Ok(0), "9 is below 5");
    bus.scs.pend_irq(2);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12), "2 is above 5");
    assert_eq!(cpu.regs[14], 0xFFFF_FFF1, "returns to a handler");
    place(&mut bus, HANDLER, &[0x4770]);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.ipsr, FIRST_IRQ + 5);
    assert_eq!(cpu.take_exception(&mut bus), Ok(0), "9 still waits");
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!(cpu.ipsr, FIRST_IRQ + 9);
}

#[test]
fn masks_hold_back_what_they_should() {
    // msr basepri, r0; cpsid i; cpsie i
    let (mut cpu, mut bus) = machine(&[0xF380, 0x8811, 0xB672, 0xB662]);
    cpu.regs[0] = 0x40;
    steps(&mut cpu, &mut bus, 1);
    bus.scs.pend_irq(4);
    assert_eq!(
        cpu.take_exception(&mut bus),
        Ok(0),
        "BASEPRI masks its own level"
    );
    steps(&mut cpu, &mut bus, 1);
    bus.scs.pend_irq(3);
    assert_eq!(cpu.take_exception(&mut bus), Ok(0), "PRIMASK masks all");
    steps(&mut cpu, &mut bus, 1);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12), "3 is above BASEPRI");
    assert_eq!(cpu.ipsr, FIRST_IRQ + 3);
}

#[test]
fn basepri_max_only_raises() {
    // msr basepri_max, r0; r1; r2; mrs r3, basepri
    let (mut cpu, mut bus) = machine(&[
        0xF380, 0x8812, 0xF381, 0x8812, 0xF382, 0x8812, 0xF3EF, 0x8311,
    ]);
    (cpu.regs[0], cpu.regs[1], cpu.regs[2]) = (0x50, 0x80, 0);
    steps(&mut cpu, &mut bus, 4);
    assert_eq!(cpu.regs[3], 0x50);
}

#[test]
fn an_it_block_survives_an_interrupt() {
    // itt eq; moveq r0, #1; moveq r1, #2, with an interrupt in between.
    let (mut cpu, mut bus) = machine(&[0xBF04, 0x2001, 0x2102, 0x2203]);
    place(&mut bus, HANDLER, &[0x4770]);
    cpu.z = false;
    steps(&mut cpu, &mut bus, 2);
    bus.scs.pend_irq(1);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!(cpu.it, 0);
    steps(&mut cpu, &mut bus, 3);
    assert_eq!((cpu.regs[0], cpu.regs[1], cpu.regs[2]), (0, 0, 3));
}

#[test]
fn a_reservation_ends_with_an_exception() {
    // ldrex r1, [r0]; strex r2, r1, [r0]
    let (mut cpu, mut bus) = machine(&[0xE850, 0x1F00, 0xE840, 0x1200]);
    place(&mut bus, HANDLER, &[0x4770]);
    cpu.regs[0] = RAM + 0x40;
    steps(&mut cpu, &mut bus, 1);
    bus.scs.pend_irq(1);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    steps(&mut cpu, &mut bus, 2);
    assert_eq!(cpu.regs[2], 1, "the store must fail");
}

#[test]
fn sleep_ends_with_an_event_or_an_interrupt() {
    // sev; wfe; wfe
    let (mut cpu, mut bus) = machine(&[0xBF40, 0xBF20, 0xBF20]);
    steps(&mut cpu, &mut bus, 2);
    assert!(!cpu.sleeping, "the event was there");
    steps(&mut cpu, &mut bus, 1);
    assert!(cpu.sleeping);
    bus.scs.primask = true;
    bus.scs.pend_irq(1);
    assert_eq!(cpu.take_exception(&mut bus), Ok(0));
    assert!(!cpu.sleeping, "a masked interrupt wakes, too");
}

#[test]
fn supervisor_calls_and_the_process_stack() {
    // msr psp, r0; msr control, r1; svc 0
    let (mut cpu, mut bus) = machine(&[0xF380, 0x8809, 0xF381, 0x8814, 0xDF00]);
    place(&mut bus, HANDLER, &[0x4770]);
    assert_eq!(bus.write(0xE000_ED1F, 1, 0x20), Ok(()));
    (cpu.regs[0], cpu.regs[1]) = (RAM + 0x800, 2);
    steps(&mut cpu, &mut bus, 3);
    assert_eq!(cpu.regs[13], RAM + 0x800);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!(
        (cpu.ipsr, cpu.regs[14], cpu.regs[13]),
        (SVC, 0xFFFF_FFFD, STACK)
    );
    assert_eq!(cpu.other_sp, RAM + 0x800 - 32);
    steps(&mut cpu, &mut bus, 1);
    assert_eq!((cpu.regs[13], cpu.pc), (RAM + 0x800, CODE + 10));
}

#[test]
fn a_stack_that_overflows_becomes_a_hard_fault_where_faults_are_delivered() {
    let (mut cpu, mut bus) = machine(&[0xBF00]);
    cpu.regs[13] = RAM + 8;
    bus.scs.pend_irq(1);
    let below = Trap::Bus {
        address: RAM - 24,
        write: true,
    };
    assert_eq!(cpu.clone().take_exception(&mut bus.clone()), Err(below));
    bus.scs.delivers_faults = true;
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!((cpu.ipsr, cpu.regs[13]), (3, RAM - 24));
    assert_eq!(bus.read(0xE000_ED28, 4), Ok(1 << 12), "STKERR");
    // A fault within the fault handler locks the core up; the first one here does not.
    assert!(!bus.scs.escalate(Trap::Undefined));
    let (_, mut other) = machine(&[]);
    assert!(other.scs.escalate(Trap::Bus {
        address: 0x6000_0000,
        write: false
    }));
    assert_eq!(other.read(0xE000_ED38, 4), Ok(0x6000_0000));
    assert_eq!(other.scs.most_urgent(), Some((3, -1)));
}

#[test]
fn an_interrupt_whose_priority_nobody_set_is_noticed() {
    let (mut cpu, mut bus) = machine(&[0xBF00]);
    assert_eq!(bus.write(0xE000_E100, 4, 1 << 20), Ok(()));
    bus.scs.pend_irq(20);
    assert_eq!(cpu.take_exception(&mut bus), Ok(12));
    assert_eq!(bus.scs.unset_priority, Some(FIRST_IRQ + 20));
}

#[test]
fn access_to_nothing_and_to_a_stopped_peripheral_are_distinguished() {
    let mut bus = bus();
    let nothing = Trap::Bus {
        address: 0x2000_5000,
        write: false,
    };
    assert_eq!(bus.read(0x2000_5000, 4), Err(nothing));
    let off = Trap::ClockOff {
        address: 0x4001_080C,
    };
    assert_eq!(bus.read(0x4001_080C, 4), Err(off));
    assert_eq!(bus.write(0x4002_1018, 4, 1 << 2), Ok(()));
    assert_eq!(bus.read(0x4001_080C, 4), Ok(0));
    // Bit 3 of the output register, by its bit-band alias.
    assert_eq!(bus.write(0x4200_0000 + 0x1_080C * 32 + 12, 4, 1), Ok(()));
    assert_eq!(bus.read(0x4001_080C, 4), Ok(8));
}
