//! The control tick: SysTick, 1 kHz, above everything else. Only it accesses the control core. Its
//! steps and their order are in the library (`mcdpr_firmware::cycle`).

use crate::bench::Gauge;
use crate::clock::{self, CYCLES_PER_TICK};
use crate::identity::{self, Reset};
use crate::life::{self, Part};
use crate::link;
use crate::pins::{self, CABLES};
use crate::{can, encoders, interrupts, keep, tension, uart};
use core::ptr;
use core::sync::atomic::{AtomicPtr, Ordering};
use cortex_m::peripheral::{DCB, DWT};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::io::{Board, Line};
use mcdpr_firmware::kept::KeptLengths;
use mcdpr_firmware::link::TickEnds;
use mcdpr_firmware::supply::Supply;
use mcdpr_firmware::{Active, Cycle, Inputs, Outputs, State};
use mcdpr_protocol::message::PANIC_BYTES;
use mcdpr_protocol::{Bench, FaultId, Info, Kept, List, Tick};
use static_cell::StaticCell;

/// Greatest interval between the starts of two ticks: a tenth late is an overrun (P5).
// 7,200 cycles, 0.1 ms.
const LATE_CYCLES: u32 = CYCLES_PER_TICK + CYCLES_PER_TICK / 10;

/// Counts core clock cycles from here on.
pub fn start_cycle_counter(mut dcb: DCB, mut dwt: DWT) {
    dcb.enable_trace();
    dwt.enable_cycle_counter();
}

/// Pins, counters and drives.
pub struct Rim {
    /// The drives' bus.
    pub can: can::Bus,
    /// The supply, by which the converter's readings are scaled.
    pub supply: Supply,
    /// Commands to the drives and their feedback.
    pub drives: DriveBus<CABLES>,
    /// Bytes from the host's line.
    pub tap: uart::Tap,
    /// Text of the last fatal error.
    pub last_panic: List<u8, PANIC_BYTES>,
    /// Measurements of the chip for the self-test.
    pub gauge: Gauge,
    /// Lengths that a reset leaves.
    pub lengths: keep::Lengths,
}

impl Line for Rim {
    fn arrived(&mut self) -> u32 {
        self.tap.arrived()
    }

    #[inline]
    fn byte(&self, number: u32) -> u8 {
        self.tap.byte(number)
    }
}

impl Board<CABLES> for Rim {
    fn read(&mut self, inputs: &mut Inputs<CABLES>) {
        inputs.encoders = encoders::read();
        inputs.tension_adc = tension::read(&mut self.supply);
        inputs.e_stop = pins::e_stop();
        inputs.gripper_switch = pins::gripper_switch();
        inputs.fault_line_low = pins::fault_line_low();
        inputs.line_errors = link::take_line_errors();
        self.can.watch();
        self.drives.listen(&mut self.can);
        self.drives.fill(inputs);
    }

    fn apply(&mut self, now: Tick, config: Option<&Active<CABLES>>, outputs: &Outputs<CABLES>) {
        pins::apply(outputs);
        self.drives.tick(now, config, outputs, &mut self.can);
        if outputs.can_loop {
            self.can.begin_loop();
        }
        if let Some(last) = self.drives.take_new() {
            // Stored as soon as drives may be commanded: a reset in the next tick must already find
            // it.
            keep::store(&last);
        }
    }

    fn complete(&self, info: &mut Info) {
        identity::complete(info, &self.last_panic);
    }

    fn measure(&mut self, report: &mut Bench, inputs: &Inputs<CABLES>) {
        self.gauge.fill(report, self.supply.millivolts(), inputs);
    }

    fn keep(&mut self, lengths: Option<&KeptLengths<CABLES>>) {
        self.lengths.keep(lengths);
    }

    fn kept(&self, kept: &mut Kept) {
        self.lengths.tell(kept);
    }

    fn show(&mut self, state: State, now: Tick) {
        pins::show(state, now);
    }
}

/// The state of the tick.
struct Core {
    cycle: &'static mut Cycle<CABLES>,
    rim: Rim,
    ends: TickEnds<'static, CABLES>,
    /// Cycle counter at the last tick's start; `None` before the first.
    started: Option<u32>,
}

impl Core {
    fn tick(&mut self) {
        let cycles = DWT::cycle_count();
        let last = self.started.replace(cycles);
        let now = Tick(clock::advance());

        // Wrapping: the cycle counter passes its end every 60 s.
        let late = last.is_some_and(|last| cycles.wrapping_sub(last) > LATE_CYCLES);
        self.cycle.tick(now, late, &mut self.rim, &mut self.ends);
        // At the end: a tick that hangs does not report in.
        life::show(Part::Tick);
        let gauge = &mut self.rim.gauge;
        gauge.count(now.0);
        gauge.took(DWT::cycle_count().wrapping_sub(cycles));
    }
}

/// The core, from before the first tick on.
static CORE: AtomicPtr<Core> = AtomicPtr::new(ptr::null_mut());

/// Gives the tick its state. Must be called before SysTick counts.
///
/// Without its crystal the board is in `Fault` permanently (P6): its ticks are as inaccurate as the
/// chip's own oscillator, and have half as many cycles.
pub fn hand_over(rim: Rim, ends: TickEnds<'static, CABLES>, reset: &Reset, crystal: bool) {
    static PLACE: StaticCell<Core> = StaticCell::new();
    static CYCLE: StaticCell<Cycle<CABLES>> = StaticCell::new();
    let cycle = CYCLE.init_with(|| Cycle::new(false));
    // P6 outweighs the cause of the last reset: it cannot be cleared.
    if !crystal {
        cycle.start_in_lasting_fault(FaultId::P6);
    } else if let Some(fault) = reset.fault() {
        cycle.start_in_fault(fault);
    }
    let core = PLACE.init(Core {
        cycle,
        rim,
        ends,
        started: None,
    });
    CORE.store(core, Ordering::Release);
}

#[cortex_m_rt::exception]
fn SysTick() {
    #[allow(unsafe_code, reason = "one owner, an interrupt: no type can say that")]
    // SAFETY: null, or the one reference that `hand_over` made and gave up; its cell gives no
    // second one. Only this handler loads it, and it does not preempt itself.
    let core = unsafe { CORE.load(Ordering::Acquire).as_mut() };
    if let Some(core) = core {
        core.tick();
    }
    interrupts::leave_event();
}
