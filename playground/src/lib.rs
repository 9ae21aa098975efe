//! The playground: the page with a simulated robot behind it, in a browser and without a server.
//!
//! The planner, the host's half of the protocol, the control core and the physics are those of the program.
//! They wait for a robot by calling [`Host::pause`]; in a browser that call suspends WebAssembly, so that
//! the page goes on meanwhile.
//!
//! | module | what it is for |
//! |---|---|
//! | [`settings`] | which robot is simulated, and where it hangs |
//! | [`stage`] | a robot, the page's orders to it, and its line, which keeps pace with the clock |
//! | `browser` | the functions that a browser calls, and those that it supplies |

#[cfg(target_arch = "wasm32")]
mod browser;
pub mod settings;
pub mod stage;

pub use settings::Settings;
pub use stage::run;

/// What a playground needs of the page around it.
pub trait Host {
    /// Waits for this long, ms; 0 lets the page work for a moment.
    fn pause(&self, ms: f64);
    /// Any time that only grows, ms.
    fn now_ms(&self) -> f64;
    /// The next message of the page, if there is one.
    fn take(&self) -> Option<String>;
    /// The bytes of the file that the page sent last, once.
    fn file(&self) -> Option<Vec<u8>>;
    /// Passes a message to the page.
    fn deliver(&self, text: &str);
}
