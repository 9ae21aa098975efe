//! Implementation of each row of the fault list at the plant, the bus, the pins, the line or the
//! host.

use super::{Injection, Snag, Supply};
use mcdpr_protocol::FaultId;
use mcdpr_simulator::plant::{CableFaults, EncoderFault, PlantError, PlantParams, TensionFault};
use mcdpr_simulator::{BoardFailure, FaultLineTap, Simulation, WireFaults};

/// A contact at full strength carries this share of the platform's weight (C5): the board's limit is a
/// fifth of it, or more where cables are tight against each other.
const CONTACT_SHARE: f64 = 1.0 / 3.0;
/// A dragging brake at full strength takes this share of what the motor has: all of it also where the load helps (D4).
const DRAG_SHARE: f64 = 4.0 / 3.0;
/// A drifted sensor at full strength is off by this share of its range (S10).
const OFFSET_SHARE: f64 = 1.0 / 8.0;

/// Where a fault is injected, in words; or why it cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum How {
    /// At the plant: mechanics, sensors, drives, brakes, supply.
    Plant(&'static str),
    /// On the line between host and board.
    Line(&'static str),
    /// In the host's program, as a crash or a stall would do it.
    Host(&'static str),
    /// Not at all.
    Not(&'static str),
}

/// How a row is injected.
#[must_use]
pub const fn how(fault: FaultId) -> How {
    match fault {
        FaultId::L1 => How::Line("half a percent of the bytes have a flipped bit"),
        FaultId::L3 => How::Line("half a percent of the bytes vanish"),
        FaultId::L4 => How::Line("half a percent of the bytes arrive twice"),
        FaultId::L8 => How::Line("nine bytes of ten have a flipped bit"),
        FaultId::L9 => How::Host("the host is silent for 60 ms"),
        FaultId::L10 | FaultId::L12 | FaultId::L15 => How::Host("the host falls silent for good"),
        FaultId::L11 => How::Line("nothing arrives any more, in either direction"),
        FaultId::L16 => How::Line("nothing arrives at the host"),
        FaultId::L18 => How::Line("twenty bytes of noise arrive in every millisecond"),
        FaultId::S1 => How::Plant("one encoder reading is off by 500 counts"),
        FaultId::S2 => How::Plant("the encoder's count stays"),
        FaultId::S4 => How::Plant("the encoder counts backwards from now on"),
        FaultId::S5 => How::Plant("20 mm of cable slip off the drum"),
        FaultId::S6 => How::Plant("the encoder's inputs are open: the count stays and flickers"),
        FaultId::S7 => How::Plant("the tension input is open"),
        FaultId::S8 => How::Plant("the tension input is shorted"),
        FaultId::S9 => How::Plant("the tension sensor's noise is ten times as large"),
        FaultId::S10 => How::Plant("the tension sensor is off by an eighth of its range"),
        FaultId::S11 => How::Plant("the tension reading freezes"),
        FaultId::D1 => How::Plant("the drive bus carries nothing"),
        FaultId::D2 => {
            How::Plant("the drive fails: it gives no torque, and a CiA 402 drive says so")
        }
        FaultId::D3 => How::Plant("the drive sends no feedback"),
        FaultId::D4 => {
            How::Plant("the brake drags with a third more than the motor has behind its gear")
        }
        FaultId::D5 => How::Plant("the drive never comes up"),
        FaultId::D6 => How::Plant("the drive reports that it is too hot (CiA 402 only)"),
        FaultId::D7 => How::Plant("the drive ignores its commands"),
        FaultId::B1 => How::Plant("the brake stays closed"),
        FaultId::B2 => How::Plant("the brake holds a fiftieth of what it should"),
        FaultId::B3 => How::Plant("the brake closes 300 ms late"),
        FaultId::P2 => How::Plant("drives and brakes lose their supply"),
        FaultId::P7 => How::Plant("the emergency stop is pressed"),
        FaultId::C1 => How::Plant("5 mm of cable slip off the drum"),
        FaultId::C2 => How::Plant("1 mm of cable is drawn in between drum and platform"),
        FaultId::C3 => How::Plant("the cable breaks"),
        FaultId::C4 => How::Plant("the drum winds 10 % more cable per turn"),
        FaultId::C5 => How::Plant("something carries a third of the platform's weight"),
        FaultId::P1 | FaultId::P3 | FaultId::P4 | FaultId::P5 | FaultId::P6 => {
            How::Not("it happens to the processor; the tests of the emulated chip show it")
        }
        FaultId::S12 => {
            How::Not("no run of the demo looks through the camera; tests/tests/collect.rs shows it")
        }
        FaultId::S3 | FaultId::K9 => {
            How::Not("a counter that wraps is not a fault; tests begin just before it")
        }
        FaultId::L2 | FaultId::L5 | FaultId::L6 | FaultId::L7 => {
            How::Not("this program sends no such frame; tests of the board's side do")
        }
        FaultId::L19 => How::Not("it takes a second board: `wire:BOARD` pulls its plug"),
        FaultId::L13 | FaultId::L14 => {
            How::Not("it takes a second program; start one, or see the tests")
        }
        FaultId::L17 => {
            How::Not("program and simulated board have the same version; tests show it")
        }
        FaultId::F3 | FaultId::F4 => How::Not("it cannot happen: the board stores nothing"),
        FaultId::F8 => How::Not("it happens to the disk; tests show it"),
        FaultId::K4 | FaultId::K5 | FaultId::K6 | FaultId::K7 | FaultId::K8 | FaultId::K10 => {
            How::Not("this program sends no such request; tests of the board's side do")
        }
        _ => How::Not("it is refused before anything moves; tests show it"),
    }
}

/// Effect of a fault on the host's side of the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HostSide {
    /// Nothing.
    Fine,
    /// It sends nothing for this long, µs.
    Silent(u64),
}

/// Injects it.
///
/// # Errors
/// The plant's, if a strength is invalid there.
pub(super) fn apply(
    simulation: &mut Simulation,
    injection: &Injection,
) -> Result<HostSide, PlantError> {
    let Injection {
        fault,
        cable,
        strength,
        ..
    } = *injection;
    if let Some(supply) = injection.supply {
        return cut(simulation, supply);
    }
    if let Some(snag) = injection.snag {
        let plant = simulation.plant_mut();
        let tool_m = plant.params().platform.tcp_m;
        let along = match snag {
            Snag::Fast => None,
            Snag::Against(along) => Some(along),
        };
        return plant.hook(tool_m, along).map(|()| HostSide::Fine);
    }
    // Some bytes always arrive: a line that loses all of them is another fault (L11).
    let line = |rate: f64| (rate * strength).min(0.95);
    let mut to_board = WireFaults::default();
    match fault {
        FaultId::L1 => to_board.corrupt = line(0.005),
        FaultId::L3 => to_board.drop = line(0.005),
        FaultId::L4 => to_board.duplicate = line(0.005),
        FaultId::L8 => to_board.corrupt = line(0.9),
        FaultId::L18 => to_board.noise_per_s = 20_000.0 * strength,
        FaultId::L9 => return Ok(HostSide::Silent(60_000)),
        FaultId::L19 => {
            simulation.set_fault_line_of(cable, FaultLineTap::Cut);
            return Ok(HostSide::Fine);
        }
        FaultId::L10 | FaultId::L12 | FaultId::L15 => return Ok(HostSide::Silent(u64::MAX)),
        FaultId::L11 | FaultId::L16 => {
            let dead = WireFaults {
                drop: 1.0,
                ..WireFaults::default()
            };
            let to_board = if fault == FaultId::L11 {
                dead
            } else {
                to_board
            };
            simulation.set_link_faults(to_board, dead);
            return Ok(HostSide::Fine);
        }
        _ => {
            return apply_to_plant(simulation, fault, cable, strength).map(|()| HostSide::Fine);
        }
    }
    // Noise is for the board's receiver, which counts it (L18).
    let to_host = WireFaults {
        noise_per_s: 0.0,
        ..to_board
    };
    simulation.set_link_faults(to_board, to_host);
    Ok(HostSide::Fine)
}

/// The failure after which the board resets itself.
const fn failure(supply: Supply) -> Option<BoardFailure> {
    match supply {
        Supply::Dip => Some(BoardFailure::SupplyLow),
        Supply::Crash => Some(BoardFailure::Crash),
        _ => None,
    }
}

/// Cuts a supply.
fn cut(simulation: &mut Simulation, supply: Supply) -> Result<HostSide, PlantError> {
    if matches!(supply, Supply::Drives | Supply::All) {
        simulation.plant_mut().lose_supply();
    }
    if matches!(supply, Supply::Board | Supply::All) {
        simulation.set_board_power(false)?;
    }
    if let Some(failure) = failure(supply) {
        simulation.fail_board(failure, true)?;
    }
    Ok(match supply {
        Supply::Host | Supply::All => HostSide::Silent(u64::MAX),
        Supply::Board | Supply::Drives | Supply::Dip | Supply::Crash => HostSide::Fine,
    })
}

/// The platform's weight, N.
fn weight_n(params: &PlantParams) -> f64 {
    let [x, y, z] = params.gravity_mps2;
    params.platform.mass_kg * (x * x + y * y + z * z).sqrt()
}

fn apply_to_plant(
    simulation: &mut Simulation,
    fault: FaultId,
    cable: usize,
    strength: f64,
) -> Result<(), PlantError> {
    if matches!(fault, FaultId::D2 | FaultId::D6) {
        if let Some(node) = simulation.drives_mut().nodes_mut().fault_mut(cable) {
            match fault {
                // Over-current, as CiA 301 numbers it.
                FaultId::D2 => node.fault = Some(0x2310),
                _ => node.hot = true,
            }
        }
        return Ok(());
    }
    let plant = simulation.plant_mut();
    let winch = plant.params().winches.get(cable);
    let (motor_n, range_n) = winch.map_or((0.0, 0.0), |winch| {
        (winch.greatest_pull_n(), winch.sensor.range_n())
    });
    #[expect(clippy::cast_possible_truncation, reason = "saturates")]
    let jump = (500.0 * strength) as i16;
    match fault {
        FaultId::S5 => return plant.slip_cable(cable, 0.02 * strength),
        FaultId::C1 => return plant.slip_cable(cable, 0.005 * strength),
        FaultId::C2 => return plant.slip_cable(cable, -0.001 * strength),
        FaultId::C3 => return plant.break_cable(cable),
        FaultId::C4 => {
            let gain = (1.0 + 0.1 * strength).clamp(0.5, 2.0);
            return plant.set_winding_gain(cable, gain);
        }
        FaultId::C5 => {
            let held_n = CONTACT_SHARE * strength * weight_n(plant.params());
            return plant.set_load([0.0, 0.0, held_n], [0.0; 3], [0.0; 3]);
        }
        FaultId::P2 => plant.lose_supply(),
        FaultId::P7 => plant.set_e_stop(true),
        _ => {}
    }
    let faults = plant.faults_mut();
    if fault == FaultId::D1 {
        faults.bus_off = true;
    }
    let Some(of) = faults.cables.get_mut(cable) else {
        return Ok(());
    };
    match fault {
        FaultId::S1 => of.encoder = EncoderFault::Glitch(jump),
        FaultId::S2 => of.encoder = EncoderFault::Stuck,
        FaultId::S4 => of.encoder = EncoderFault::Reversed,
        FaultId::S6 => of.encoder = EncoderFault::Disconnected,
        FaultId::S7 => of.tension = TensionFault::Open,
        FaultId::S8 => of.tension = TensionFault::Short,
        FaultId::S11 => of.tension = TensionFault::Frozen,
        FaultId::S9 => of.tension_noise_factor = 10.0 * strength,
        FaultId::S10 => of.tension_offset_n = OFFSET_SHARE * strength * range_n,
        FaultId::D3 => of.drive.silent = true,
        FaultId::D4 => of.brake.drag_n = DRAG_SHARE * strength * motor_n,
        FaultId::D5 => of.drive.late_s = f64::INFINITY,
        FaultId::D7 => of.drive.ignores_commands = true,
        FaultId::B1 => of.brake.stays_closed = true,
        // A stronger fault leaves less of the brake: 1 leaves a fiftieth, 2 a hundredth.
        FaultId::B2 => of.brake.holding_factor = (0.02 / strength).min(1.0),
        FaultId::B3 => of.brake.extra_close_delay_s = 0.3 * strength,
        _ => {}
    }
    Ok(())
}

/// Removes the cause again, if possible: broken or slipped cables stay so.
///
/// # Errors
/// [`PlantError::Board`] if a board does not start again.
pub(super) fn mend(simulation: &mut Simulation, injection: &Injection) -> Result<(), PlantError> {
    let fine = WireFaults::default();
    if let Some(failure) = injection.supply.and_then(failure) {
        return simulation.fail_board(failure, false);
    }
    if injection.supply.is_some() {
        simulation.plant_mut().set_power(true);
        return simulation.set_board_power(true);
    }
    if injection.snag.is_some() {
        simulation.plant_mut().unhook();
        return Ok(());
    }
    match injection.fault {
        FaultId::L1
        | FaultId::L3
        | FaultId::L4
        | FaultId::L8
        | FaultId::L11
        | FaultId::L16
        | FaultId::L18 => simulation.set_link_faults(fine, fine),
        FaultId::L19 => simulation.set_fault_line_of(injection.cable, FaultLineTap::Whole),
        FaultId::P7 => simulation.plant_mut().set_e_stop(false),
        FaultId::P2 => simulation.plant_mut().set_power(true),
        FaultId::D1 => simulation.plant_mut().faults_mut().bus_off = false,
        FaultId::D2 | FaultId::D6 => {
            let nodes = simulation.drives_mut().nodes_mut();
            if let Some(node) = nodes.fault_mut(injection.cable) {
                (node.fault, node.hot) = (None, false);
            }
        }
        FaultId::C5 => {
            // A load of zero is finite.
            let _ = simulation
                .plant_mut()
                .set_load([0.0; 3], [0.0; 3], [0.0; 3]);
        }
        _ => {
            let faults = simulation.plant_mut().faults_mut();
            if let Some(of) = faults.cables.get_mut(injection.cable) {
                *of = CableFaults::default();
            }
        }
    }
    Ok(())
}
