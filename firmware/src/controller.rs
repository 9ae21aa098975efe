//! One tick of the board: measure, monitor, move, command; and the requests in between.

use crate::adc::is_plausible;
use crate::arming::{Arming, Oscillation, Phase, Service, concerns};
use crate::axis::{Axis, Target, motor_speed_umps};
use crate::config::{Active, CableConfig, ConfigStore, Control};
use crate::encoder::{Encoder, LengthScale, Sampled};
use crate::io::{Brake, DriveInput, Inputs, Outputs, Scan};
use crate::kept::KeptLengths;
use crate::motion::{CAPACITY, Motion};
use crate::proof::{Proof, Verdict};
use crate::segment::StoredRow;
use crate::supervisor::{self, Event, State, transition};
use crate::tension::{TensionLoop, measured_mn};
use crate::watch::{CableWatch, Heartbeat, Latch, LineNoise, LinkHealth, Persist};
use mcdpr_protocol::{
    ConfigHash, FaultId, FaultRecord, Info, Limit, Limits, List, PerCable, Reject, Reply, Request,
    ResidualRow, StopKind, Tick, Winch,
};

mod acting;
mod commanding;
mod halting;
mod knots;
mod parking;
mod relieving;
mod reporting;
mod requests;
mod watching;

use parking::Parked;
use reporting::bits;

/// Torque is held this long after the brakes have closed, ms.
// Beyond the slowest brake's time: a brake may close later than its file states (B3).
const HOLD_TORQUE_MS: u16 = 150;
/// Ticks for which the emergency input must show a change: one disturbed sample does not count. Its
/// own contacts cut the power meanwhile.
const E_STOP_TICKS: u16 = 3;
/// Ticks for which the fault line must be low: one disturbed sample does not count.
const FAULT_LINE_TICKS: u16 = 2;
/// Control ticks per second.
const TICKS_PER_SECOND: u16 = 1000;
/// A motion may start this far from the set-point, 0.1 µm (K4).
// 5 um: a sixth of an encoder count of the paper's drum (31 um).
const START_TOLERANCE: i32 = 50;

/// State of one cable.
#[derive(Debug, Clone, Copy, Default)]
struct Cable {
    encoder: Encoder,
    scale: LengthScale,
    length: i32,
    tension_mn: i32,
    /// Length by the motor, 0.1 µm, and its rate, µm/s; while armed.
    by_motor: i32,
    speed_umps: i32,
    /// Current of the motor, mA.
    current_ma: i16,
    axis: Axis,
    tension_loop: TensionLoop,
    watch: CableWatch,
    target: Target,
    /// Set-point or expected tension, mN.
    setpoint_mn: i32,
    /// Tension that the static model expects at the reference, mN.
    reference_mn: i32,
    /// The encoder cannot be trusted.
    lost: bool,
    /// A quick check found no fault in this tick.
    well: bool,
    /// Drive or encoder were lost since the board armed: its brake stays closed.
    abandoned: bool,
    /// Its drum turned against its motor since the board armed: its drive gives no torque.
    reversed: bool,
    /// Its tension reading froze since the board armed: its law continues without it.
    blind: bool,
    /// How far the cable gave way while the robot stops, 0.1 µm.
    give: i32,
    /// Speed at which it is paid out because its tension is too high, µm/s.
    letting_umps: i32,
    /// The test of its brake.
    proof: Proof,
}

impl Cable {
    /// Counts the encoder's steps; returns whether it cannot be trusted.
    #[inline]
    fn count(&mut self, encoder: u16, max_step: u16) -> bool {
        self.lost = self.encoder.sample(encoder, max_step) == Sampled::Lost;
        self.lost
    }

    /// Length and rate by the motor.
    #[inline]
    fn sense_motor(&mut self, config: &CableConfig, drive: &DriveInput) {
        self.speed_umps = motor_speed_umps(config, drive);
        self.by_motor = self.axis.by_motor(config, drive, self.speed_umps);
    }
}

/// The control core of one board with `N` winches.
#[derive(Debug, Clone)]
pub struct Controller<const N: usize> {
    state: State,
    now: Tick,
    store: ConfigStore<N>,
    active: Option<Active<N>>,
    /// The outcome of building it, until it is reported.
    built: Option<Result<(), Reject>>,
    cables: [Cable; N],
    motion: Motion<N>,
    rows: [StoredRow<N>; ResidualRow::PER_KNOT],
    residuals: [Persist; ResidualRow::PER_KNOT],
    arming: Arming,
    heartbeat: Heartbeat,
    latch: Latch,
    /// Warnings since they were last reported.
    limits: Limits,
    referenced: bool,
    overruns: u32,
    late_ticks: Persist,
    line_noise: LineNoise,
    /// Ticks since the stop began.
    stopping: u16,
    /// Ticks since the brakes were commanded to close while stopping.
    closing: Option<u16>,
    /// Ticks that brakes which are closed while holding take to open again.
    opening: u16,
    /// Ticks since a brake first slipped before torque was switched off; 0 if none did.
    slips: u16,
    /// The winch whose brake has failed since the board armed, 1 for the first; 0 for none.
    unsound: u8,
    /// The robot hangs on its brakes after it has hung on its drives.
    parked: Parked,
    /// The tension of a cable was too high: the stop in progress pays out, and does not follow the
    /// path.
    relieving: bool,
    /// Ticks since no cable is above its limit.
    calm_ticks: u16,
    oscillation: Oscillation,
    gripper_closed: bool,
    gripper_switch: bool,
    /// The emergency input, filtered, and for how long its raw value has differed.
    e_stop: bool,
    e_stop_differs: Persist,
    /// The fault line is low; never on a board that has none.
    fault_line: Persist,
    /// A fault of the board itself that no request can clear (P6).
    lasting: Option<FaultId>,
    outputs: Outputs<N>,
    /// The drives' last feedback, and the tension channels.
    drives: [DriveInput; N],
    adc: [u16; N],
    /// A single winch is enabled.
    service: Option<Service>,
    scan: Scan,
    scan_asked: bool,
    /// An output of the self-test, and the remaining ticks that it is set.
    trial: (u8, u16),
    loop_asked: bool,
}

impl<const N: usize> Default for Controller<N> {
    fn default() -> Self {
        Self {
            state: State::Boot,
            now: Tick(0),
            store: ConfigStore::default(),
            active: None,
            built: None,
            cables: [Cable::default(); N],
            motion: Motion::default(),
            rows: [StoredRow::default(); ResidualRow::PER_KNOT],
            residuals: [Persist::default(); ResidualRow::PER_KNOT],
            arming: Arming::default(),
            heartbeat: Heartbeat::default(),
            latch: Latch::default(),
            limits: Limits::default(),
            referenced: false,
            overruns: 0,
            late_ticks: Persist::default(),
            line_noise: LineNoise::default(),
            stopping: 0,
            closing: None,
            opening: 0,
            slips: 0,
            unsound: 0,
            parked: Parked::default(),
            relieving: false,
            calm_ticks: 0,
            oscillation: Oscillation::default(),
            gripper_closed: false,
            gripper_switch: false,
            e_stop: false,
            e_stop_differs: Persist::default(),
            fault_line: Persist::default(),
            lasting: None,
            outputs: Outputs::default(),
            drives: [DriveInput::default(); N],
            adc: [0; N],
            service: None,
            scan: Scan::default(),
            scan_asked: false,
            trial: (0, 0),
            loop_asked: false,
        }
    }
}

impl<const N: usize> Controller<N> {
    /// The board's state.
    #[must_use]
    pub const fn state(&self) -> State {
        self.state
    }

    /// The last tick.
    #[must_use]
    pub const fn now(&self) -> Tick {
        self.now
    }

    /// Whether drives may give torque.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        supervisor::may_give_torque(self.state)
    }

    /// Age of the host's last sign of life.
    #[must_use]
    pub fn link_health(&self, now: Tick) -> LinkHealth {
        self.heartbeat.health(now)
    }

    /// The configuration in use; none while it is being exchanged.
    #[must_use]
    pub fn config(&self) -> Option<&Active<N>> {
        self.active.as_ref().filter(|_| !self.store.is_taking())
    }

    /// The latched fault.
    #[must_use]
    pub const fn fault(&self) -> Option<FaultRecord> {
        self.latch.get()
    }

    /// The board starts after a crash, a hang or a supply that failed: the next tick goes to
    /// `Fault` with this cause (P1, P3, P4), and a host must clear it. Must be called before the
    /// first tick.
    pub fn start_in_fault(&mut self, fault: FaultId) {
        self.latch_fault(fault, 0, 0, 0);
    }

    /// As [`Self::start_in_fault`], and the cause stays: it cannot be cleared (P6).
    pub fn start_in_lasting_fault(&mut self, fault: FaultId) {
        self.lasting = Some(fault);
        self.start_in_fault(fault);
    }

    /// One control tick: the outputs of the board. `now` advances by one per call.
    pub fn step(&mut self, now: Tick, inputs: &Inputs<N>) -> Outputs<N> {
        self.tick(now, inputs);
        self.outputs
    }

    /// As [`Self::step`], without a copy: [`Self::outputs`] gives the outputs.
    pub fn tick(&mut self, now: Tick, inputs: &Inputs<N>) {
        self.now = now;
        let differs = inputs.e_stop != self.e_stop;
        if self.e_stop_differs.update(differs, E_STOP_TICKS) {
            self.e_stop = inputs.e_stop;
        }
        self.gripper_switch = inputs.gripper_switch;
        self.overruns = self.overruns.wrapping_add(u32::from(inputs.overrun));
        if self.state == State::Boot {
            self.raise(Event::Booted);
        }
        match (self.e_stop, self.state == State::EStop) {
            // The record names the cause in `Fault`, to which the release leads.
            (true, false) => {
                self.latch_fault(FaultId::P7, 0, 0, 0);
                self.raise(Event::EStopPressed);
            }
            (false, true) => {
                self.raise(Event::EStopReleased);
            }
            _ => {}
        }
        // Measure, watch, act, command: a fault of this tick's inputs changes this tick's outputs.
        self.measure(inputs);
        let noisy = self.line_noise.update(inputs.line_errors);
        let has_line = self.active.as_ref().is_some_and(|active| active.fault_line);
        if has_line {
            self.watch_fault_line(inputs.fault_line_low);
        }
        if self.is_armed() {
            if noisy {
                self.trip(FaultId::L18, 0, self.line_noise.errors(), 0);
            }
            self.watch(inputs);
            self.watch_link();
            self.act(inputs);
        }
        // Not an else: a robot that lost its torque in this very tick is parked from now on.
        if !self.is_armed() {
            self.watch_parked(inputs);
        }
        self.heartbeat.forget_expired(now);
        self.command(inputs);
    }

    /// Another board is not well, or this one pulls the fault line itself (L19).
    // Out of line: within the tick it costs registers there.
    #[inline(never)]
    fn watch_fault_line(&mut self, low: bool) {
        if low {
            self.limits.insert(Limit::FaultLine);
        }
        let lasts = self.fault_line.update(low, FAULT_LINE_TICKS);
        // A bare winch is worked on alone, and a board with a fault pulls the line itself.
        if lasts && self.is_armed() && self.service.is_none() && !self.latch.is_set() {
            self.trip(FaultId::L19, 0, 0, 0);
        }
    }

    /// Brakes are commanded to hold the drums, or are about to open.
    fn is_braked(&self) -> bool {
        let holds = self
            .active
            .as_ref()
            .is_some_and(|active| active.hold_braked);
        match self.state {
            State::Stopping => self.closing.is_some(),
            State::Holding => holds || self.unsound > 0,
            _ => self.opening > 0,
        }
    }

    /// Torque stays on because a brake does not hold.
    fn stands_for_its_brake(&self) -> bool {
        self.unsound > 0 && self.state == State::Holding
    }

    /// The outputs after the last tick.
    #[must_use]
    pub const fn outputs(&self) -> &Outputs<N> {
        &self.outputs
    }

    fn raise(&mut self, event: Event) -> bool {
        // The table decides. An event that is impossible in this state is not an error: detections
        // arrive in any state.
        let Some(next) = transition(self.state, event, self.latch.get().is_some()) else {
            return false;
        };
        if next != self.state {
            self.enter(next);
        }
        true
    }

    fn enter(&mut self, next: State) {
        let stop_ms = self.active.as_ref().map_or(1, |active| active.stop_ms);
        match next {
            State::Arming => {
                self.arming = Arming::default();
                self.opening = 0;
                self.unsound = 0;
                self.relieving = false;
                self.motion.clear();
                self.rows = Default::default();
                for cable in &mut self.cables {
                    // Counts and means of a robot at rest on its brakes do not describe one under
                    // torque.
                    cable.watch = CableWatch::default();
                    cable.abandoned = false;
                    cable.reversed = false;
                    cable.blind = false;
                    cable.give = 0;
                    cable.proof = Proof::default();
                }
            }
            // The clock takes as long to come up after a hold as it takes to stop.
            State::Moving => self.motion.run(stop_ms),
            State::Pausing => self.motion.brake(stop_ms),
            State::Stopping => {
                // All axes follow one path clock: they stop together, and the tool stays on its
                // path.
                self.motion.brake(stop_ms);
                self.stopping = 0;
                self.closing = None;
                self.slips = 0;
                self.relieving = false;
            }
            // A motion from before must never continue after a new arming.
            State::Disarmed | State::Fault | State::EStop => {
                self.motion.clear();
                self.park();
            }
            State::Boot => {}
            State::Holding => {
                self.opening = match &self.active {
                    Some(active) if active.hold_braked || self.unsound > 0 => {
                        // The configuration has no opening time: the closing time stands for it.
                        slowest_brake_ms(active) + 1
                    }
                    _ => 0,
                };
            }
        }
        self.state = next;
    }

    // Only the first fault since the last clear is kept: the later ones are mostly its
    // consequences.
    fn latch_fault(&mut self, fault: FaultId, cable: u8, value: i32, limit: i32) {
        self.latch.set(FaultRecord {
            fault,
            cable,
            tick: self.now,
            value,
            limit,
        });
    }

    fn trip(&mut self, fault: FaultId, cable: u8, value: i32, limit: i32) {
        self.latch_fault(fault, cable, value, limit);
        // A robot that is held by torque because a brake failed has no safer state: only a host's
        // stop tries the brake again.
        let reaction = supervisor::reaction(fault);
        if reaction != supervisor::Reaction::Stop || !self.stands_for_its_brake() {
            self.raise(reaction.event());
        }
        if fault == FaultId::C2 {
            self.stop_for(true);
        }
        let reversed = fault == FaultId::S4;
        let failed =
            reversed | matches!(fault, FaultId::D2 | FaultId::D3 | FaultId::D7 | FaultId::S6);
        let failed = failed && self.state == State::Stopping;
        if let Some(cable) = self.cables.get_mut(usize::from(cable).wrapping_sub(1)) {
            // A reading at a rail is reported by its own detectors (S7, S8).
            cable.blind |= fault == FaultId::S11;
            // The failed drum is braked at once: the others must not continue to pull against it. A
            // drive that does not follow commands (D7) must not give torque: an RMDS has no other
            // way to report it.
            cable.abandoned |= failed;
            cable.reversed |= reversed;
        }
        if failed {
            let stop_ms = self.active.as_ref().map_or(1, |active| active.stop_ms);
            // A braked drum no longer follows the path: the others have a quarter of the time, 75
            // ms of 300, before cables become slack or too tight.
            self.motion.brake(stop_ms / 4);
        }
    }

    /// Stops, unless a failed brake has no safer state; with `tight`, a cable is over its limit.
    fn stop_for(&mut self, tight: bool) {
        if !self.stands_for_its_brake() {
            self.raise(Event::Stop);
        }
        // A path that ends in 300 ms would pull on against the snag. Once brakes close, there is
        // nothing left to pay out.
        if tight && self.state == State::Stopping && self.closing.is_none() {
            self.relieve();
        }
    }

    /// The lengths that a board keeps over a reset; `None` without a reference.
    pub(crate) fn to_keep(&self) -> Option<KeptLengths<N>> {
        let cables = &self.cables;
        self.referenced.then(|| KeptLengths {
            lengths: core::array::from_fn(|cable| cables.get(cable).map_or(0, |c| c.length)),
            brakes_open: bits(&self.outputs.brakes.map(|brake| brake == Brake::Open)),
        })
    }

    #[inline(never)]
    fn measure(&mut self, inputs: &Inputs<N>) {
        self.scan = inputs.scan;
        self.adc = inputs.tension_adc;
        self.drives = inputs.drives;
        let armed = self.is_armed();
        let watched = armed && self.watches_cables();
        let readings = inputs.encoders.iter().zip(&inputs.tension_adc);
        let readings = readings.zip(&inputs.drives);
        let cables = self.cables.iter_mut().zip(readings);
        let mut lost = false;
        // A configuration that is being overwritten has mixed values: nothing may be scaled with
        // it.
        let taking = self.store.is_taking();
        let Some(active) = self.active.as_ref().filter(|_| !taking) else {
            for (cable, ((&encoder, _), drive)) in cables {
                cable.current_ma = drive.current_ma;
                // Without a configuration the largest step is unknown: the counter is followed
                // across its wrap.
                lost |= cable.count(encoder, u16::MAX);
            }
            self.referenced &= !lost;
            return;
        };
        let timeout_ms = active.feedback_timeout_ms;
        for ((cable, ((&encoder, &adc), drive)), config) in cables.zip(&active.cables) {
            cable.current_ma = drive.current_ma;
            lost |= cable.count(encoder, config.max_encoder_step);
            cable.length = cable.scale.length(cable.encoder.counts()).0;
            cable.tension_mn = measured_mn(config, adc);
            if armed {
                cable.sense_motor(config, drive);
            }
            // Here, because all values that it compares are available.
            cable.well = watched && cable.is_well(config, drive, adc, timeout_ms);
            // Before the drums are free, the readings show how often this channel repeats by
            // itself.
            if armed && !watched {
                cable.watch.learn(adc);
            }
        }
        // In every state: these lengths are uncertain from here on.
        self.referenced &= !lost;
    }
}

/// The longest closing time of a brake, ms.
#[inline(never)]
fn slowest_brake_ms<const N: usize>(active: &Active<N>) -> u16 {
    let cables = active.cables.iter();
    cables.map(|cable| cable.brake_close_ms).max().unwrap_or(0)
}
