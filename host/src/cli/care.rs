//! `mcdpr care`: bending cycles, loads and remaining life of cables, and what drums and brakes did.

use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json, write_out};
use crate::care;
use mcdpr_core::care::{CableWear, Rope};
use serde_json::json;
use std::path::PathBuf;

/// Wear of cables, drums and brakes, counted from runs, and the life that is left
///
/// Runs on a port are counted when they end. Records are counted with --add
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Count recorded runs: their folders, or their run.mcap. None counts twice
    #[arg(long, value_name = "RUN", num_args = 1..)]
    add: Vec<PathBuf>,
    /// This cable is new: its counts begin at zero
    #[arg(long, value_name = "CABLE")]
    renewed: Vec<usize>,
    /// What the cables are made of, from now on
    #[arg(long, value_enum)]
    material: Option<Material>,
    /// How many bendings the maker's test of a polymer cable lasted, and at which tension
    #[arg(long, num_args = 2, value_names = ["BENDINGS", "N"])]
    tested: Option<Vec<f64>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Material {
    Steel,
    Polymer,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let mut wear = care::load(&robot)?;
        let mut changed = false;
        for number in &self.renewed {
            let slot = number.checked_sub(1).and_then(|i| wear.cables.get_mut(i));
            let Some(slot) = slot else {
                let reason = format!("{} has cables 1 to {}", robot.name, robot.cables.len());
                return Err(Failed::from_error("--renewed")(reason).into());
            };
            *slot = CableWear {
                rope: slot.rope,
                ..CableWear::default()
            };
            changed = true;
        }
        if let Some(rope) = self.rope()? {
            for cable in &mut wear.cables {
                cable.rope = rope;
            }
            changed = true;
        }
        for path in &self.add {
            if !care::add(&robot, &mut wear, path)? {
                eprintln!("{} was counted before", path.display());
            }
            changed = true;
        }
        if changed && !common.dry_run {
            care::keep(&robot, &wear)?;
        }
        if common.json {
            let cables: Vec<_> = wear.cables.iter().map(document).collect();
            return print_json(&json!({
                "file": care::path_of(&robot)?,
                "robot": wear.robot,
                "runs": wear.runs.len(),
                "brake_closings": wear.brake_closings,
                "cables": cables,
            }));
        }
        let head = [
            "cable",
            "bendings",
            "life used",
            "hours left",
            "hours loaded",
            "greatest, N",
            "travel, m",
            "reversals",
        ];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for (number, cable) in (1..).zip(&wear.cables) {
            let used = cable.used().map(|used| format!("{:.2} %", used * 100.0));
            let left = cable.hours_left().map(|hours| format!("{hours:.0}"));
            table.push(vec![
                number.to_string(),
                format!("{:.0}", cable.worst()),
                used.unwrap_or_else(|| "not known".to_owned()),
                left.unwrap_or_else(|| "-".to_owned()),
                format!("{:.2}", cable.hours()),
                format!("{:.1}", cable.greatest_n),
                format!("{:.1}", cable.travel_m),
                cable.reversals.to_string(),
            ]);
        }
        write_out(&lay_out(&table));
        say!(
            "{} runs counted, brakes closed {} times. Bendings are those of the worst 10 mm; the life of \
             steel (Feyrer's equation, constants not verified) is uncertain by a factor of ten at these diameters, that of polymer is what its maker tested",
            wear.runs.len(),
            wear.brake_closings
        );
        let beyond = wear.cables.iter().any(|cable| cable.beyond_test_s > 0.0);
        if beyond {
            say!(
                "some cables were loaded beyond the maker's test: what they were bent there is not covered by it"
            );
        }
        Ok(())
    }

    /// What the cables are, if it was said.
    fn rope(&self) -> miette::Result<Option<Rope>> {
        let tested = match self.tested.as_deref() {
            None => None,
            Some(&[bendings, tension_n]) if bendings >= 1.0 && tension_n > 0.0 => {
                Some([bendings, tension_n])
            }
            Some(_) => {
                let reason = "give at least one bending, and a tension over 0 N";
                return Err(Failed::from_error("--tested")(reason).into());
            }
        };
        Ok(match (self.material, tested) {
            (Some(Material::Steel), Some(_)) => {
                let reason = "the life of steel follows from Feyrer's equation: leave it out";
                return Err(Failed::from_error("--tested")(reason).into());
            }
            (Some(Material::Steel), None) => Some(Rope::Steel),
            (Some(Material::Polymer), tested) => Some(Rope::Polymer { tested }),
            (None, Some(tested)) => Some(Rope::Polymer {
                tested: Some(tested),
            }),
            (None, None) => None,
        })
    }
}

fn document(cable: &CableWear) -> serde_json::Value {
    json!({
        "rope": cable.rope,
        "bendings_worst": cable.worst(),
        "life_used": cable.used(),
        "hours_left": cable.hours_left(),
        "loaded_s": cable.loaded_s,
        "greatest_n": cable.greatest_n,
        "travel_m": cable.travel_m,
        "drum_reversals": cable.reversals,
        "beyond_test_s": cable.beyond_test_s,
    })
}
