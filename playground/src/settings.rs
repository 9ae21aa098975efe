//! Which robot is simulated.

use mcdpr_core::motion::Model;
use mcdpr_core::robot::{BUILT_IN, BuiltInModules, Robot};
use mcdpr_twin::asked::three;
use mcdpr_twin::plant::Mismatch;
use nalgebra::Vector3;
use serde_json::{Value, json};

/// The robot of a playground that was opened without a link.
const FIRST: &str = "paper-table5";
/// Longest text of a robot file.
const MOST_BYTES: usize = 256 << 10;

/// What makes a simulated robot what it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Name of the robot or its file.
    pub name: String,
    /// Text of the robot file.
    pub text: String,
    /// The seed of its errors and noise.
    pub seed: u64,
    /// Whether it is exactly as described.
    pub exact: bool,
    /// Where its tool hangs at first, world, m; `None`: at home.
    pub tool_m: Option<[f64; 3]>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            name: FIRST.to_owned(),
            text: built_in(FIRST).unwrap_or_default().to_owned(),
            seed: 1,
            exact: false,
            tool_m: None,
        }
    }
}

/// The text of a robot that the program carries.
#[must_use]
pub fn built_in(name: &str) -> Option<&'static str> {
    let mut robots = BUILT_IN.iter();
    robots
        .find(|(known, _)| *known == name)
        .map(|(_, text)| *text)
}

impl Settings {
    /// Changed by a message: `robot` (the name of a built-in one), `text`, `name`, `seed`, `exact`,
    /// `tool_mm`; what it does not have stays. `damaged` says that it could not be read.
    ///
    /// # Errors
    /// What is wrong with it, in words.
    pub fn changed(&self, message: &Value) -> Result<Self, String> {
        if message["damaged"] == json!(true) {
            return Err("the link to this page is damaged: it was ignored".to_owned());
        }
        let mut new = self.clone();
        if let Some(name) = message["robot"].as_str() {
            let text = built_in(name).ok_or_else(|| {
                let names: Vec<_> = BUILT_IN.iter().map(|(name, _)| *name).collect();
                format!("there is no robot {name}; there are {}", names.join(", "))
            })?;
            (new.name, new.text, new.tool_m) = (name.to_owned(), text.to_owned(), None);
        }
        if let Some(text) = message["text"].as_str() {
            if text.len() > MOST_BYTES {
                return Err(format!("a robot file has at most {} kB", MOST_BYTES >> 10));
            }
            text.clone_into(&mut new.text);
        }
        if let Some(name) = message["name"].as_str() {
            name.clone_into(&mut new.name);
        }
        if !message["seed"].is_null() {
            let seed = message["seed"].as_u64();
            new.seed = seed.ok_or("a seed is a whole number from 0 on")?;
        }
        if let Some(exact) = message["exact"].as_bool() {
            new.exact = exact;
        }
        if !message["tool_mm"].is_null() {
            let tool_mm = three(message, "tool_mm").ok_or("a place is three numbers in mm")?;
            new.tool_m = Some(tool_mm.map(|v| v * 1e-3));
        }
        Ok(new)
    }

    /// Its robot.
    ///
    /// # Errors
    /// Every mistake in the robot file, in words.
    pub fn robot(&self) -> Result<Robot, String> {
        Robot::parse(&self.text, &self.name, &BuiltInModules).map_err(|error| error.plain_words())
    }

    /// Its model.
    ///
    /// # Errors
    /// As [`Self::robot`], and what the model refuses.
    pub fn model(&self) -> Result<Model, String> {
        Model::new(&self.robot()?).map_err(|error| error.to_string())
    }

    /// Errors of the simulated machine.
    #[must_use]
    pub fn mismatch(&self) -> Mismatch {
        if self.exact {
            Mismatch::default()
        } else {
            Mismatch::realistic()
        }
    }

    /// Where the tool hangs at first, world, m; `None`: at home.
    #[must_use]
    pub fn place_m(&self) -> Option<Vector3<f64>> {
        self.tool_m.map(Vector3::from)
    }

    /// As a message that [`Self::changed`] reads.
    #[must_use]
    pub fn message(&self) -> Value {
        let own = built_in(&self.name) != Some(self.text.as_str());
        let tool_mm = self.tool_m.map(|tool_m| tool_m.map(|v| v * 1e3));
        let mut message = json!({ "seed": self.seed, "exact": self.exact, "tool_mm": tool_mm });
        if own {
            message["name"] = json!(self.name);
            message["text"] = json!(self.text);
        } else {
            message["robot"] = json!(self.name);
        }
        message
    }
}
