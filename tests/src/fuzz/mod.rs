//! What must hold whatever arrives: each function takes any input and panics where a rule is broken.
//!
//! `fuzz/` feeds them from a coverage-guided fuzzer, `tests/tests/fuzz.rs` from seeded generators.

pub mod files;
pub mod mutate;
pub mod planning;
pub mod wire;

/// The control core's own bench: a server with a small plant on its pins.
#[path = "../../../firmware/tests/core/support.rs"]
#[allow(
    dead_code,
    missing_docs,
    clippy::allow_attributes_without_reason,
    clippy::unwrap_used,
    clippy::panic,
    clippy::missing_panics_doc,
    clippy::indexing_slicing,
    clippy::must_use_candidate,
    clippy::new_without_default,
    clippy::needless_range_loop,
    clippy::should_implement_trait,
    clippy::missing_errors_doc,
    clippy::too_many_lines
)]
mod bench;
