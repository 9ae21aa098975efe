//! `mcdpr commission WINCH`: commissioning of one bare winch.

use super::service::{Connected, Machine, connected};
use super::{Common, Failed, Outcome, print_json};
use crate::files::write_atomically;
use crate::link::SimulatedLink;
use crate::robot::{Robot, Winch};
use crate::service::{Asked, Commissioned, Operator, commission};
use std::io::{BufRead, IsTerminal, Write};
use std::path::PathBuf;

/// Bring up one bare winch: find its drive, directions, brake and sensor zero; write its module file
///
/// No cable may be on the drum. Only this winch moves: slowly, at most three eighths of a turn, with half of its motor's
/// current. Against its closed brake it pushes with up to nine tenths. Finds friction, play and torsional stiffness;
/// with `--weight-kg` it asks for a weight on the drum at the end, raises and lowers it, and finds the gear's loss
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Number of the winch, as its cable in the robot file, from 1
    winch: usize,
    /// Number of its drive, if several answer that the robot file does not name
    #[arg(long, value_name = "N")]
    node: Option<u8>,
    /// Module file to write
    #[arg(long, value_name = "FILE", default_value = "winch-module.toml")]
    out: PathBuf,
    /// Answer in advance: does the drum pay out cable when it is turned?
    #[arg(long, value_name = "yes|no")]
    paid_out: Option<YesNo>,
    /// Weight to hang on the drum when the bare winch is known, kg: finds the gear's loss in both directions
    #[arg(long, value_name = "KG", value_parser = super::numbers::positive)]
    weight_kg: Option<f64>,
    /// Temperature at the winch, kept with the results, degrees Celsius
    #[arg(long, value_name = "C", allow_negative_numbers = true)]
    temperature_c: Option<f64>,
    #[command(flatten)]
    machine: Machine,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum YesNo {
    Yes,
    No,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        crate::service::known(&robot, self.winch)?;
        let asked = Asked {
            node: self.node,
            weight_n: self.weight_kg.map(|kg| kg * mcdpr_kinematics::GRAVITY_MPS2),
        };
        let work = |(mut client, simulated): Connected<'_>| {
            let mut eyes = Eyes::new(self.paid_out, simulated, self.winch);
            eyes.piped = common.for_page.is_some();
            let found = commission(&mut client, &robot, self.winch, &asked, &mut eyes)?;
            Ok(Commissioned {
                temperature_c: self.temperature_c,
                ..found
            })
        };
        let name = format!("commission-{}", self.winch);
        let (found, folder) = connected(common, &robot, &self.machine, &name, work)?;
        write_atomically(&self.out, module_text(&found, &robot))
            .map_err(Failed::from_error(&self.out.display().to_string()))?;
        folder
            .plot(
                "commission",
                &crate::service::figure(&found, &robot.name),
                common.plots(),
            )
            .map_err(Failed::from_error("drawing the measurements"))?;
        folder
            .write_json("commission.json", &found)
            .map_err(Failed::from_error("writing the results"))?;
        if common.json {
            return print_json(&found);
        }
        say!(
            "winch {}: drive {} ({} answer), brake held {:.2} A with {:.2} degrees of play, opens and closes",
            found.winch,
            found.node,
            found.nodes_found.len(),
            found.brake_held_a,
            found.brake_play_deg
        );
        say!(
            "motor_counts_per_turn {}, encoder_sign {}, tension_zero_v {:.4} (one reading varies by {:.1} mV)",
            found.motor_counts_per_turn,
            found.encoder_sign,
            found.tension_zero_v,
            found.tension_noise_v * 1e3
        );
        if let Some(rubs) = &found.rubbing {
            if let Some(friction) = &rubs.friction {
                say!(
                    "friction {:.3} mN m at the motor (standard error {:.3}), {:.2} N at the cable",
                    friction.friction_nm * 1e3,
                    friction.friction_se_nm * 1e3,
                    friction.friction_n,
                );
            }
            if let Some(why) = &rubs.friction_unknown {
                say!("friction is not known, the robot file's value is kept: {why}");
            }
            say!(
                "play {:.2} degrees (standard error {:.2})",
                rubs.play_deg,
                rubs.play_se_deg
            );
        }
        if let Some(loss) = &found.loss {
            say!(
                "efficiency {:.1} % (standard error {:.1}), driven {:.1} % (standard error {:.1}); the sensor reads {:.2} N of {:.2} N",
                loss.efficiency * 100.0,
                loss.efficiency_se * 100.0,
                loss.backdrive_efficiency * 100.0,
                loss.backdrive_efficiency_se * 100.0,
                loss.sensor_n,
                loss.weight_n
            );
        }
        if let Some(yields) = &found.stiffness {
            say!(
                "torsional stiffness {:.0} N m/rad (standard error {:.0}) with an efficiency of {:.0} % ({})",
                yields.stiffness_nm_per_rad,
                yields.stiffness_se_nm_per_rad,
                yields.efficiency * 100.0,
                if found.loss.is_some() {
                    "measured"
                } else {
                    "the robot file's: `--weight-kg` measures it"
                }
            );
        }
        if let Some(why) = &found.stiffness_unknown {
            say!("torsional stiffness is not known, the robot file's value is kept: {why}");
        }
        for line in &found.differs {
            say!("differs: {line}");
        }
        say!(
            "written to {}: name it as `module` in the [[winch]] table, or compose a robot of such files \
             (mcdpr config compose)",
            self.out.display()
        );
        say!(
            "run folder: {} (commission.{} shows what was measured)",
            folder.path().display(),
            common.plots().ending()
        );
        Ok(())
    }
}

/// Source of the answer about the drum: given in advance, the simulated drum itself, or the user.
struct Eyes {
    given: Option<YesNo>,
    simulated: Option<(SimulatedLink, usize)>,
    before_m: f64,
    /// Standard input has the user's answers though it is no terminal.
    piped: bool,
}

impl Eyes {
    fn new(given: Option<YesNo>, simulated: Option<SimulatedLink>, winch: usize) -> Self {
        let mut eyes = Self {
            given,
            simulated: simulated.map(|link| (link, winch.wrapping_sub(1))),
            before_m: 0.0,
            piped: false,
        };
        eyes.before_m = eyes.drum_m().unwrap_or(0.0);
        eyes
    }

    /// The user's answer; none without a terminal or a page.
    fn ask(&self, question: &str) -> Option<bool> {
        let mut input = std::io::stdin().lock();
        if !std::io::stdin().is_terminal() && !self.piped {
            return None;
        }
        eprint!("{question}");
        std::io::stderr().flush().ok()?;
        let mut line = String::new();
        input.read_line(&mut line).ok()?;
        match line.trim() {
            "y" | "yes" => Some(true),
            "n" | "no" => Some(false),
            _ => None,
        }
    }

    /// The answer of an observer of the simulated machine.
    fn drum_m(&self) -> Option<f64> {
        let (link, index) = self.simulated.as_ref()?;
        let truth = link.with(|simulation| simulation.plant().truth()).ok()?;
        truth.drum_positions_m.get(*index).copied()
    }
}

impl Operator for Eyes {
    fn hang(&mut self, weight_n: f64) -> bool {
        if let Some((link, index)) = &self.simulated {
            let hung = link.with(|simulation| {
                simulation
                    .plant_mut()
                    .hang_weight(*index, Some(weight_n))
                    .is_ok()
            });
            return hung;
        }
        let kg = weight_n / mcdpr_kinematics::GRAVITY_MPS2;
        self.ask(&format!(
            "Wind half a turn of cable onto the drum, lead it over its sensor and hang {kg} kg on it, free to rise by an \
             eighth of a turn. Does it hang? [y/n] "
        )) == Some(true)
    }

    fn paid_out(&mut self) -> Option<bool> {
        if let Some(given) = self.given {
            return Some(given == YesNo::Yes);
        }
        if let Some(now_m) = self.drum_m() {
            // The simulated drum's displacement grows while it pays out.
            return Some(now_m > self.before_m);
        }
        self.ask("The drum has just turned. Would that have paid out cable? [y/n] ")
    }
}

/// The whole module file: the results, and the robot file's values for the rest.
fn module_text(found: &Commissioned, robot: &Robot) -> String {
    let Some(w) = robot.winch_of(found.winch.wrapping_sub(1)) else {
        return String::new();
    };
    let drive = match w.drive {
        crate::robot::DriveKind::Rmds => "rmds",
        crate::robot::DriveKind::Cia402 => "cia402",
    };
    format!(
        "# Winch module, found by `mcdpr commission {winch}` on the bare winch{at}.\n\
         node = {node}\n\
         encoder_sign = {sign}\n\
         motor_counts_per_turn = {counts}\n\
         tension_zero_v = {zero:.4}\n\
         drive = \"{drive}\"\n\n\
         # As the robot file described it; `mcdpr calibrate winch {winch}` measures the ratio.\n\
         encoder_counts_per_turn = {encoder}\n\
         tension_gain_n_per_v = {gain}\n\
         tension_max_n = {most}\n\
         gear_ratio = {gear}\n\
         drum_radius_mm = {radius}\n\
         cable_diameter_mm = {diameter}\n\
         turns_max = {turns}\n\
         drum_inertia_kg_m2 = {inertia}\n\
         max_motor_rpm = {rpm}\n\
         max_current_a = {current}\n\
         torque_constant_nm_per_a = {torque}\n\
         rotor_inertia_kg_m2 = {rotor}\n\
         {friction}\n\
         brake_close_ms = {brake}\n\
         drive_hold_up_ms = {hold}\n\
         brake_play_deg = {play:.3}\n\
         drive_bandwidth_rad_s = {bandwidth}\n\
         current_lag_ms = {lag}\n",
        winch = found.winch,
        at = found
            .temperature_c
            .map_or_else(String::new, |c| format!(" at {c} degrees Celsius")),
        node = found.node,
        sign = found.encoder_sign,
        counts = found.motor_counts_per_turn,
        zero = found.tension_zero_v,
        encoder = w.encoder_counts_per_turn,
        gain = w.tension_gain_n_per_v,
        most = w.tension_max_n,
        gear = w.gear_ratio,
        radius = milli(w.drum_radius_m),
        diameter = milli(w.cable_diameter_m),
        turns = w.turns_max,
        inertia = w.drum_inertia_kg_m2,
        rpm = w.max_motor_rpm,
        current = w.max_current_a,
        torque = w.torque_constant_nm_per_a,
        rotor = w.rotor_inertia_kg_m2,
        friction = friction_text(found, w),
        brake = milli(w.brake_close_s),
        hold = milli(w.drive_hold_up_s),
        // A robot file accepts no more than 2 degrees.
        play = found.brake_play_deg.min(2.0),
        bandwidth = w.drive_bandwidth_rad_s,
        lag = milli(w.current_lag_s),
    )
}

/// The friction lines of the module: on the gear, if the file has one.
fn friction_text(found: &Commissioned, winch: &Winch) -> String {
    let mut winch = winch.clone();
    found.describe(&mut winch);
    let Some(gear) = &winch.gear else {
        return format!("friction_n = {:.2}", winch.friction_n);
    };
    format!(
        "friction_n = {}\nrotor_friction_mnm = {:.4}\ngear_friction_mnm = {:.4}\n\
         static_friction = {}\nstribeck_rpm = {}\nviscous_mnm_per_krpm = {:.4}\n\
         gear_efficiency = {:.4}\nbackdrive_efficiency = {:.4}\nplay_deg = {:.3}\n\
         torsional_stiffness_nm_per_rad = {:.1}\ncogging_mnm = {}\ncogging_per_turn = {}\ncold_friction = {}\n\
         drum_eccentricity_mm = {}",
        winch.friction_n,
        gear.rotor_friction_nm * 1e3,
        gear.gear_friction_nm * 1e3,
        gear.static_friction,
        gear.stribeck_rpm,
        // From N m per rpm to mN m per 1000 rpm.
        gear.viscous_nm_per_rpm * 1e6,
        gear.efficiency,
        gear.backdrive_efficiency,
        gear.play_rad.to_degrees(),
        gear.stiffness_nm_per_rad,
        gear.cogging_nm * 1e3,
        gear.cogging_per_turn,
        gear.cold_friction,
        milli(winch.drum_eccentricity_m),
    )
}

/// Rounded to thousandths, without binary rounding noise.
fn milli(value: f64) -> f64 {
    (value * 1e9).round() / 1e6
}
