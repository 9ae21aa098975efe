//! The progress bar on standard error; disabled if that is not a terminal.

use crate::run::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;

/// A bar for one motion.
pub(crate) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(crate) fn new(name: &'static str) -> Self {
        let bar = ProgressBar::new(0);
        let style = ProgressStyle::with_template("{prefix:>24} [{wide_bar}] {msg}");
        if let Ok(style) = style {
            bar.set_style(style);
        }
        bar.set_prefix(name);
        Self { bar }
    }

    pub(crate) fn update(&self, progress: Progress) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates"
        )]
        let ms = |seconds: f64| (seconds * 1e3).round() as u64;
        self.bar.set_length(ms(progress.duration_s));
        self.bar.set_position(ms(progress.path_s));
        self.bar.set_message(format!(
            "{:5.1} of {:.1} s",
            progress.path_s, progress.duration_s
        ));
    }

    pub(crate) fn finish(self) {
        self.bar.finish_and_clear();
    }
}

/// How often the line of a phase is drawn again.
const REDRAW: Duration = Duration::from_millis(200);

/// A line on standard error with what is being done, and for how long; disabled if that is not a
/// terminal. It disappears when it is dropped, which must be before anything else is printed.
pub(crate) struct Phase {
    bar: ProgressBar,
}

impl Phase {
    pub(crate) fn begin(what: &'static str) -> Self {
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}, {elapsed}") {
            bar.set_style(style);
        }
        bar.set_message(what);
        bar.enable_steady_tick(REDRAW);
        Self { bar }
    }
}

impl Drop for Phase {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// A bar of things that are done one by one, on any thread; disabled if standard error is not a terminal. It disappears
/// when it is dropped, which must be before anything else is printed.
pub(crate) struct Count {
    bar: ProgressBar,
}

impl Count {
    pub(crate) fn begin(what: &'static str, total: u64) -> Self {
        let bar = ProgressBar::new(total);
        let style = "{prefix:>24} [{wide_bar}] {pos} of {len}, {elapsed}";
        if let Ok(style) = ProgressStyle::with_template(style) {
            bar.set_style(style);
        }
        bar.set_prefix(what);
        bar.enable_steady_tick(REDRAW);
        Self { bar }
    }

    pub(crate) fn one_more(&self) {
        self.bar.inc(1);
    }
}

impl Drop for Count {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
