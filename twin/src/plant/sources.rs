//! What a machine is off by, group by group, so that a study can leave a group out or make it smaller.

use super::{GearMismatch, Mismatch};

/// A group of a machine's errors. The draws of the others stay as they are when one is changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Force and moment that no model has.
    Wrench,
    /// Where the platform truly hangs when a session begins at home.
    Homing,
    /// Gain and zero of the load cells.
    Cells,
    /// Noise of the load cells beyond the usual one.
    Noise,
    /// Radius of each drum.
    Drums,
    /// Friction, loss, play and torsion of the gears, and the drives' bandwidth.
    Gears,
    /// Tension lost at the pulleys.
    Pulleys,
    /// Stiffness of the cables.
    Stiffness,
    /// Mass and centre of mass.
    Platform,
    /// Anchors and attachments.
    Frame,
}

/// The word for all groups.
const ALL: &str = "all";

impl Source {
    /// Every group.
    pub const ALL: [Self; 10] = [
        Self::Wrench,
        Self::Homing,
        Self::Cells,
        Self::Noise,
        Self::Drums,
        Self::Gears,
        Self::Pulleys,
        Self::Stiffness,
        Self::Platform,
        Self::Frame,
    ];

    /// Its word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Wrench => "wrench",
            Self::Homing => "homing",
            Self::Cells => "cells",
            Self::Noise => "noise",
            Self::Drums => "drums",
            Self::Gears => "gears",
            Self::Pulleys => "pulleys",
            Self::Stiffness => "stiffness",
            Self::Platform => "platform",
            Self::Frame => "frame",
        }
    }
}

impl Mismatch {
    /// The same machine with a group of its errors `share` times as large.
    #[must_use]
    pub fn scaled(mut self, source: Source, share: f64) -> Self {
        let scaled: &mut [&mut f64] = match source {
            Source::Wrench => &mut [&mut self.found.force, &mut self.found.moment_m],
            Source::Homing => &mut [&mut self.found.homing_m],
            Source::Cells => &mut [&mut self.sensor_gain, &mut self.found.zero],
            Source::Noise => &mut [&mut self.found.noise],
            Source::Drums => &mut [&mut self.found.drum],
            Source::Gears => {
                let GearMismatch {
                    friction,
                    loss,
                    play,
                    stiffness,
                } = &mut self.gears;
                &mut [friction, loss, play, stiffness, &mut self.bandwidth]
            }
            Source::Pulleys => &mut [&mut self.pulley_loss],
            Source::Stiffness => &mut [&mut self.ea],
            Source::Platform => &mut [&mut self.center_of_mass_m, &mut self.mass],
            Source::Frame => &mut [&mut self.anchors_m, &mut self.attachments_m],
        };
        for value in scaled {
            **value *= share;
        }
        self
    }

    /// A machine by its name: a kind (`realistic`, `as-found` and so on), and after commas groups of its errors with the share of
    /// them that it has, each from 0 to 1: `as-found,wrench=0.25`. `all` is every group; a later word goes before an
    /// earlier one, so that `as-found,all=0,wrench=1` has nothing but the wrench.
    ///
    /// # Errors
    /// The word that means nothing.
    ///
    /// ```
    /// use mcdpr_twin::plant::Mismatch;
    ///
    /// let found = Mismatch::as_found();
    /// let quiet = Mismatch::parse("as-found,wrench=0.25")?;
    /// assert_eq!(quiet.found.force, 0.25 * found.found.force);
    /// assert_eq!(quiet.anchors_m, found.anchors_m);
    /// assert!(Mismatch::parse("as-found,wind=0").is_err());
    /// # Ok::<(), String>(())
    /// ```
    pub fn parse(name: &str) -> Result<Self, String> {
        let (kind, shares) = name.split_once(',').unwrap_or((name, ""));
        let built = Self::kind(kind).ok_or_else(|| format!("no kind of machine is `{kind}`"))?;
        let mut factors = [1.0; Source::ALL.len()];
        for word in shares.split(',').filter(|word| !word.is_empty()) {
            let (of, share) = word
                .split_once('=')
                .ok_or_else(|| format!("`{word}` is not a group with its share: wrench=0.5"))?;
            let share: f64 = share
                .parse()
                .ok()
                .filter(|share| (0.0..=1.0).contains(share))
                .ok_or_else(|| format!("the share in `{word}` is not a number from 0 to 1"))?;
            let mut known = false;
            for (source, factor) in Source::ALL.iter().zip(&mut factors) {
                if of == ALL || of == source.word() {
                    (*factor, known) = (share, true);
                }
            }
            if !known {
                let words = Source::ALL.map(Source::word).join(", ");
                return Err(format!(
                    "`{of}` is no group of errors: all, or one of {words}"
                ));
            }
        }
        let scaled = Source::ALL.iter().zip(factors);
        Ok(scaled.fold(built, |built, (source, share)| built.scaled(*source, share)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_error_of_a_machine_is_in_no_group_or_in_two() {
        let none = Mismatch::parse("as-found,all=0").unwrap();
        assert_eq!(none, Mismatch::default());
        // Half of everything, group by group, is half of everything once.
        let halves = Source::ALL
            .iter()
            .fold(Mismatch::as_found(), |m, source| m.scaled(*source, 0.5));
        let once = Mismatch::parse("as-found,all=0.5").unwrap();
        assert_eq!(halves, once);
        assert_eq!(once.gears.play, 0.5 * Mismatch::as_found().gears.play);
        assert_eq!(once.anchors_m, 0.5 * Mismatch::as_found().anchors_m);
    }

    #[test]
    fn a_later_word_goes_before_an_earlier_one() {
        let alone = Mismatch::parse("as-found,all=0,wrench=1").unwrap();
        assert_eq!(alone.found.moment_m, Mismatch::as_found().found.moment_m);
        assert_eq!((alone.anchors_m, alone.found.homing_m), (0.0, 0.0));
        let overruled = Mismatch::parse("as-found,wrench=0,all=1").unwrap();
        assert_eq!(overruled, Mismatch::as_found());
    }

    #[test]
    fn what_means_nothing_is_refused_by_its_word() {
        for (name, word) in [
            ("lost", "`lost`"),
            ("as-found,wind=0", "`wind`"),
            ("as-found,wrench", "`wrench`"),
            ("as-found,wrench=2", "`wrench=2`"),
            ("as-found,wrench=-0.1", "`wrench=-0.1`"),
            ("as-found,wrench=NaN", "`wrench=NaN`"),
            ("as-found,wrench=much", "`wrench=much`"),
        ] {
            let error = Mismatch::parse(name).unwrap_err();
            assert!(error.contains(word), "{name}: {error}");
            assert!(Mismatch::named(name).is_none());
        }
    }
}
