//! `mcdpr monitor`: a robot that another mcdpr moves, in a terminal.

use super::{Common, Failed, Outcome, print_json, write_out};
use crate::control::{SocketError, View, call_all};
use crate::record::words;
use crate::run::{interrupted, watch_for_interrupts};
use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::time::Duration;

/// Refresh interval.
const LOOK: Duration = Duration::from_millis(100);
/// Width of a tension's bar, characters.
const BAR: usize = 24;

/// Watch a robot that another terminal moves: state, lengths, tensions
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Print the state once
    #[arg(long)]
    once: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let terminal = std::io::stdout().is_terminal() && !common.json;
        let most = crate::robot::find(&common.robot)?.limits.tension_max_n;
        let mut seen = false;
        while !interrupted() {
            let views = match call_all(&common.on, &common.robot, None) {
                Ok(views) => views,
                // It existed and has ended: that ends the watch without an error.
                Err(SocketError::Nobody { .. } | SocketError::System { .. }) if seen => break,
                Err(error) => return Err(error.into()),
            };
            if common.json {
                for view in &views {
                    print_json(view)?;
                }
            } else {
                let text: String = views.iter().map(|view| screen(view, most)).collect();
                if terminal && seen {
                    // Up to the beginning of the last picture.
                    write_out(&format!("\x1b[{}A\x1b[J", text.lines().count()));
                }
                write_out(&text);
            }
            seen = true;
            if self.once {
                break;
            }
            std::thread::sleep(LOOK);
        }
        Ok(())
    }
}

/// One robot as lines of text.
fn screen(view: &View, most_n: f64) -> String {
    // Writing to a string cannot fail.
    let mut out = String::new();
    let words = view.state.map_or("not known yet", words::state);
    let _ = writeln!(
        out,
        "{:<9} {words}{}",
        view.state
            .map_or("?".to_owned(), |state| format!("{state:?}")),
        if view.paused { " (paused)" } else { "" }
    );
    let _ = writeln!(
        out,
        "task      {}  {:.2} of {:.2} s",
        view.task.as_deref().unwrap_or("none"),
        view.path_s,
        view.duration_s
    );
    let _ = writeln!(out, "fault     {}", view.fault.as_deref().unwrap_or("none"));
    let _ = writeln!(out, "cable  length, mm  set-point, mm  tension, N");
    for (index, length_m) in view.lengths_m.iter().enumerate() {
        let setpoint_mm = view.setpoints_m.get(index).map_or(f64::NAN, |m| m * 1e3);
        let tension_n = view.tensions_n.get(index).copied().unwrap_or(0.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a few characters"
        )]
        let filled = ((tension_n / most_n).clamp(0.0, 1.0) * BAR as f64).round() as usize;
        let _ = writeln!(
            out,
            "{:>5}  {:>10.2}  {setpoint_mm:>13.2}  {tension_n:>10.2}  {}{}",
            index + 1,
            length_m * 1e3,
            "#".repeat(filled),
            ".".repeat(BAR - filled)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_is_reported_in_lines_of_constant_number() {
        let mut view = View {
            lengths_m: vec![0.3171, 0.4791],
            setpoints_m: vec![0.317, 0.479],
            tensions_n: vec![10.0, 41.0],
            ..View::default()
        };
        let before = screen(&view, 40.0);
        assert!(
            before.contains("317.10") && before.contains("######......"),
            "{before}"
        );
        view.fault = Some("S5: closure".to_owned());
        view.state = Some(mcdpr_protocol::BoardState::Fault);
        let after = screen(&view, 40.0);
        assert_eq!(before.lines().count(), after.lines().count());
        assert!(
            after.contains("S5: closure") && after.starts_with("Fault"),
            "{after}"
        );
    }
}
