//! What Start begins: the plan that is shown, and nothing else.

/// The latest plan that was asked for.
#[derive(Debug, Clone, Default)]
enum Latest<T> {
    /// There is none, or it was discarded.
    #[default]
    Nothing,
    /// It is being made.
    Waiting(T),
    /// It breaks a limit, or cannot be made at all.
    Refused,
    /// It is within every limit.
    Allowed(T),
}

/// Plans that a page asked for, of which only the latest counts. `T` is the task.
#[derive(Debug, Clone)]
pub struct Plans<T> {
    /// Number of the latest request.
    asked: u64,
    latest: Latest<T>,
    /// The task that was started last; `None`: the program's own.
    begun: Option<T>,
}

impl<T> Default for Plans<T> {
    fn default() -> Self {
        Self {
            asked: 0,
            latest: Latest::Nothing,
            begun: None,
        }
    }
}

impl<T: Clone> Plans<T> {
    /// Asks for a plan; gives its number. Whatever was planned before can no longer be started.
    pub fn ask(&mut self, wanted: T) -> u64 {
        self.asked += 1;
        self.latest = Latest::Waiting(wanted);
        self.asked
    }

    /// The plan that is to be made, and its number.
    #[must_use]
    pub fn waiting(&self) -> Option<(u64, T)> {
        match &self.latest {
            Latest::Waiting(wanted) => Some((self.asked, wanted.clone())),
            _ => None,
        }
    }

    /// The plan with this number was made, and is within every limit or not. Returns whether it still
    /// counts: a newer request makes it worthless.
    pub fn settle(&mut self, number: u64, allowed: bool) -> bool {
        let Some((_, wanted)) = self.waiting().filter(|(waiting, _)| *waiting == number) else {
            return false;
        };
        self.latest = if allowed {
            Latest::Allowed(wanted)
        } else {
            Latest::Refused
        };
        true
    }

    /// Forgets the plan.
    pub fn forget(&mut self) {
        self.asked += 1;
        self.latest = Latest::Nothing;
    }

    /// Decides what a start begins: the latest plan (that of `number`, if one is given), or the program's
    /// own task where no plan was asked for. Plans that are asked for later do not change it.
    ///
    /// # Errors
    /// The reason, in words: a start must not begin another task than the one that is shown.
    pub fn begin(&mut self, number: Option<u64>) -> Result<(), &'static str> {
        if number.is_some_and(|number| number != self.asked) {
            return Err("another plan has taken its place: plan it again");
        }
        self.begun = match &self.latest {
            Latest::Waiting(_) => return Err("it is still being planned"),
            Latest::Refused => return Err("the plan breaks a limit: discard it, or plan another"),
            Latest::Allowed(task) => Some(task.clone()),
            Latest::Nothing if number.is_some() => return Err("there is no plan: plan it again"),
            Latest::Nothing => None,
        };
        Ok(())
    }

    /// The task that was started last; `None`: the program's own.
    #[must_use]
    pub fn begun(&self) -> Option<T> {
        self.begun.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_begins_what_is_shown() {
        let mut plans = Plans::default();
        assert!(plans.begin(Some(1)).is_err());
        assert_eq!((plans.begin(None), plans.begun()), (Ok(()), None));
        let near = plans.ask("near");
        assert!(plans.begin(None).is_err(), "it is still being planned");
        assert!(plans.settle(near, true) && !plans.settle(near, true));
        assert_eq!((plans.begin(None), plans.begun()), (Ok(()), Some("near")));
        let (far, old) = (plans.ask("far"), near);
        assert!(!plans.settle(old, true) && plans.settle(far, false));
        for number in [None, Some(far), Some(old)] {
            assert!(plans.begin(number).is_err(), "{number:?}");
        }
        assert_eq!(plans.begun(), Some("near"), "it was not replaced");
        plans.forget();
        assert!(plans.begin(Some(far)).is_err());
        assert_eq!((plans.begin(None), plans.begun()), (Ok(()), None));
    }
}
