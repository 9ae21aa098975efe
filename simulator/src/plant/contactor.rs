//! The contactor of a drive's supply, which the board's drive enable (PB3) closes.

/// From the coil's voltage until its contacts are closed, and from its loss until they are open (s).
/// Schneider Electric, TeSys D, LC1D09BD (24 V DC coil): "operating time", 53.55 to 72.45 ms closing, 16 to
/// 24 ms opening; here the middle of each. The data sheet was not at hand: compare before you rely on it.
const CLOSES_S: f64 = 0.063;
const OPENS_S: f64 = 0.020;

/// One drive's contactor. It is closed until a board first says otherwise: a plant alone has none.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Contactor {
    /// What the board has asked for last: closed or open.
    asked: Option<bool>,
    open: bool,
    changes_at_s: Option<f64>,
}

impl Contactor {
    /// The board's output.
    pub(super) fn ask(&mut self, closed: bool, now_s: f64) {
        match self.asked.replace(closed) {
            // A board that starts has its output low since long ago.
            None => self.open = !closed,
            Some(before) if before != closed => {
                let delay_s = if closed { CLOSES_S } else { OPENS_S };
                self.changes_at_s = Some(now_s + delay_s);
            }
            Some(_) => {}
        }
    }

    /// Whether the drive has its supply, if there is one.
    pub(super) const fn is_closed(&self) -> bool {
        !self.open
    }

    /// Whether the contacts have opened since the last call.
    #[inline(always)]
    pub(super) fn opens(&mut self, now_s: f64) -> bool {
        if self.changes_at_s.is_none_or(|at_s| now_s < at_s) {
            return false;
        }
        self.changes_at_s = None;
        let open = self.asked == Some(false);
        let opens = open && !self.open;
        self.open = open;
        opens
    }
}
