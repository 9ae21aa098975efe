//! The control tick: SysTick, 1 kHz, above everything else. It alone owns the control core.
//!
//! Order within a tick: read, step, apply, so that outputs follow inputs at a constant distance;
//! then requests, which act from the next tick on; then what there is to tell.

use crate::bench::Gauge;
use crate::identity::{self, Reset};
use crate::life::{self, Part};
use crate::link::{self, TickEnds};
use crate::pins::{self, CABLES};
use crate::start::CYCLES_PER_TICK;
use crate::{can, encoders, interrupts, keep, tension};
use core::ptr;
use core::sync::atomic::{AtomicPtr, AtomicU32, Ordering};
use cortex_m::peripheral::{DCB, DWT};
use mcdpr_firmware::drives::DriveBus;
use mcdpr_firmware::io::Board;
use mcdpr_firmware::supply::Supply;
use mcdpr_firmware::{Inputs, Outputs, Server};
use mcdpr_protocol::message::PANIC_BYTES;
use mcdpr_protocol::{FaultId, List, Reply, Tick};
use static_cell::StaticCell;

/// From one tick's start to the next, at most: a tenth late is an overrun (P5).
const LATE_CYCLES: u32 = CYCLES_PER_TICK + CYCLES_PER_TICK / 10;

static NOW: AtomicU32 = AtomicU32::new(0);

/// Ticks since the start, wrapping.
pub fn now() -> u32 {
    NOW.load(Ordering::Relaxed)
}

/// Counts core clock cycles from here on.
pub fn start_cycle_counter(mut dcb: DCB, mut dwt: DWT) {
    dcb.enable_trace();
    dwt.enable_cycle_counter();
}

/// The rim: pins, counters and drives.
pub struct Rim {
    /// The drives' bus.
    pub can: can::Bus,
    /// What the converter's readings are worth.
    pub supply: Supply,
    /// What the drives are told and what they say.
    pub drives: DriveBus<CABLES>,
}

impl Board<CABLES> for Rim {
    fn now(&self) -> Tick {
        Tick(now())
    }

    fn read(&mut self, inputs: &mut Inputs<CABLES>) {
        inputs.encoders = encoders::read();
        inputs.tension_adc = tension::read(&mut self.supply);
        inputs.e_stop = pins::e_stop();
        inputs.gripper_switch = pins::gripper_switch();
        inputs.line_errors = link::take_line_errors();
        self.can.watch();
        self.drives.listen(&mut self.can);
        self.drives.fill(inputs);
    }

    fn apply(&mut self, outputs: &Outputs<CABLES>) {
        pins::apply(outputs);
    }

    fn safe_off(&mut self) {
        pins::safe_off();
    }
}

/// All that a tick works with.
struct Core {
    server: &'static mut Server<CABLES>,
    rim: Rim,
    /// What was read in this tick; here, so that it is not made anew in each.
    inputs: Inputs<CABLES>,
    ends: TickEnds,
    last_panic: List<u8, PANIC_BYTES>,
    gauge: Gauge,
    /// This tick did a self-test.
    tested: bool,
    /// The last tick executed a command.
    executed_before: bool,
    /// Cycle counter at the last tick's start; `None` before the first.
    started: Option<u32>,
}

impl Core {
    fn tick(&mut self) {
        let cycles = DWT::cycle_count();
        let last = self.started.replace(cycles);
        let now = Tick(NOW.load(Ordering::Relaxed).wrapping_add(1));
        NOW.store(now.0, Ordering::Relaxed);

        let late = last.is_some_and(|last| cycles.wrapping_sub(last) > LATE_CYCLES);
        self.control(now, late);
        let executed = self.execute(now);
        // A command and the state each take their time: not both in one tick, unless one command
        // follows the other.
        let tells_state = !executed || self.executed_before;
        self.executed_before = executed;
        self.tell(now, tells_state);
        life::show(Part::Tick);
        self.gauge.count(now.0);
        let took = DWT::cycle_count().wrapping_sub(cycles);
        // A self-test takes its own time, and nothing has torque then.
        if took > self.gauge.tick_cycles && !core::mem::take(&mut self.tested) {
            self.gauge.tick_cycles = took;
        }
    }

    /// Out of line, as are the other two: the stack of one is gone before the next one's comes.
    #[inline(never)]
    fn control(&mut self, now: Tick, late: bool) {
        self.rim.read(&mut self.inputs);
        self.inputs.overrun = late;
        self.server.tick(now, &self.inputs);
        let controller = self.server.controller();
        let outputs = controller.outputs();
        self.rim.apply(outputs);
        let Rim { can, drives, .. } = &mut self.rim;
        drives.tick(now, controller.config(), outputs, can);
        if outputs.can_loop {
            can.begin_loop();
        }
        if let Some(last) = drives.take_new() {
            keep::store(&last);
        }
    }

    /// Executes a command, if one waits; whether it did.
    #[inline(never)]
    fn execute(&mut self, now: Tick) -> bool {
        let mut executed = false;
        // One at most: the line could bring six, which wait in its ring.
        if let Some(command) = self.ends.commands.peek() {
            if !self.ends.answers.ready() {
                return false;
            }
            executed = true;
            if !self.server.prepare(command) {
                return executed;
            }
            let mut answer = self.server.receive(now, command, &link::counters());
            self.ends.commands.dequeue();
            if let Ok(Reply::Info(info)) = &mut answer.result {
                identity::complete(info, &self.last_panic);
            } else if let Ok(Reply::Bench(report)) = &mut answer.result {
                let supply_mv = self.rim.supply.millivolts();
                self.gauge.tell(report, supply_mv, &self.inputs);
                self.tested = true;
            }
            // There is room: it was just seen, and nobody else fills it.
            let _ = self.ends.answers.enqueue(answer);
        }
        if link::is_damaged()
            && self.ends.answers.ready()
            && link::take_damaged()
            && let Some(answer) = self.server.complain()
        {
            let _ = self.ends.answers.enqueue(answer);
        }
        executed
    }

    #[inline(never)]
    fn tell(&mut self, now: Tick, tells_state: bool) {
        if tells_state
            && self.server.status_is_due()
            && self.ends.states.ready()
            && let Some(status) = self.server.take_status(&link::counters())
        {
            let _ = self.ends.states.enqueue(status);
        }
        if let Some(row) = self.server.take_row()
            && self.ends.rows.enqueue(row).is_err()
        {
            link::drop_telemetry();
        }
        let state = self.server.controller().state();
        pins::show(state, now);
    }
}

/// The core, from before the first tick on.
static CORE: AtomicPtr<Core> = AtomicPtr::new(ptr::null_mut());

/// Gives the tick all that it owns. Before SysTick counts.
///
/// Without its crystal the board is in `Fault` for good (P6): its ticks are as inaccurate as the
/// chip's own oscillator, and half as long in cycles.
pub fn hand_over(rim: Rim, ends: TickEnds, reset: &Reset, crystal: bool) {
    static PLACE: StaticCell<Core> = StaticCell::new();
    static SERVER: StaticCell<Server<CABLES>> = StaticCell::new();
    let server = SERVER.init_with(|| Server::new(false));
    if !crystal {
        server.start_in_lasting_fault(FaultId::P6);
    } else if let Some(fault) = reset.fault() {
        server.start_in_fault(fault);
    }
    let core = PLACE.init(Core {
        server,
        rim,
        inputs: Inputs::default(),
        ends,
        last_panic: reset.last_panic.clone(),
        gauge: Gauge::new(reset.flags, crystal),
        tested: false,
        executed_before: false,
        started: None,
    });
    CORE.store(core, Ordering::Release);
}

#[cortex_m_rt::exception]
fn SysTick() {
    #[allow(unsafe_code, reason = "one owner, an interrupt: no type can say that")]
    // SAFETY: null, or the one reference that `hand_over` made and gave up; the cell it made it
    // from gives no second. Only this handler loads it, and it does not preempt itself.
    let core = unsafe { CORE.load(Ordering::Acquire).as_mut() };
    if let Some(core) = core {
        core.tick();
    }
    interrupts::leave_event();
}
