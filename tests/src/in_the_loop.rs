//! Boards in the loop: the emulated chip behind three wires, in a process of its own, or a real one.

use crate::process::first_line;
use crate::{chip, mcdpr};
use mcdpr::hil::Wires;
use std::process::Child;

/// Environment variable that puts the tests' boards into the loop: `emulated`, or the `hil:PORT,CAN,PORT`
/// of a real one.
pub const VARIABLE: &str = "MCDPR_IN_THE_LOOP";

/// `mcdpr emulate FIRMWARE --hil` in its own process; ended with the test.
#[derive(Debug)]
pub struct Emulated {
    child: Child,
    /// Value of `--on` for a program that has it in the loop.
    pub on: String,
}

impl Emulated {
    /// Starts one. Its time passes as the other side says, or with a scale by itself.
    ///
    /// # Panics
    /// Where it does not start.
    #[must_use]
    pub fn start(time_scale: Option<&str>) -> Self {
        let mut command = mcdpr();
        command.arg("emulate").arg(chip::path()).arg("--hil");
        if let Some(scale) = time_scale {
            command.args(["--time-scale", scale]);
        }
        let (child, line) = first_line(command);
        let on = line.trim().to_owned();
        assert!(on.starts_with("hil:"), "the emulated chip said: {line}");
        Self { child, on }
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

thread_local! {
    /// The board of a test: one thread runs a test, one robot after the other.
    static OWN: std::cell::RefCell<Option<Emulated>> = const { std::cell::RefCell::new(None) };
}

/// The wires to the board in the loop that [`VARIABLE`] asks for; `None` without it. An emulated one is
/// the calling thread's own.
///
/// # Panics
/// Where the variable names no board.
#[must_use]
pub fn wires() -> Option<Wires> {
    let named = std::env::var(VARIABLE).ok()?;
    let on = if named == "emulated" {
        OWN.with_borrow_mut(|own| {
            let emulated = own.get_or_insert_with(|| Emulated::start(None));
            emulated.on.clone()
        })
    } else {
        named
    };
    let wires = Wires::parse(&on, 1.0);
    assert!(wires.is_ok(), "{VARIABLE}: {wires:?}");
    wires.ok()
}
