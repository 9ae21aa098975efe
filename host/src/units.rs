//! Numbers with units on the command line: `0.255m`, `12cm`, `-4 deg`, `10`.

use std::f64::consts::PI;

/// Quantity of a number: its permitted units, and its default unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Quantity {
    /// A length; mm without a unit.
    Length,
    /// An angle; degrees without a unit.
    Angle,
    /// A force; N without a unit.
    Force,
}

impl Quantity {
    /// Name and unit table: spelling and SI value of one.
    const fn table(self) -> (&'static str, &'static [(&'static str, f64)]) {
        match self {
            // The first is the default.
            Self::Length => (
                "length",
                &[
                    ("mm", 1e-3),
                    ("cm", 1e-2),
                    ("m", 1.0),
                    ("um", 1e-6),
                    ("in", 0.0254),
                ],
            ),
            Self::Angle => (
                "angle",
                &[
                    ("deg", PI / 180.0),
                    ("rad", 1.0),
                    ("mrad", 1e-3),
                    ("°", PI / 180.0),
                ],
            ),
            Self::Force => ("force", &[("N", 1.0), ("kN", 1e3), ("mN", 1e-3)]),
        }
    }

    /// The value in SI units (m, rad, N) of a text such as `12cm`.
    ///
    /// # Errors
    /// [`UnitError`] for a text that is not a finite number followed by one of the units, or by
    /// none.
    pub fn parse(self, text: &str) -> Result<f64, UnitError> {
        let (name, units) = self.table();
        let text = text.trim();
        let (number, unit) = text.split_at(number_length(text));
        let unit = unit.trim_start();
        let known = || {
            units
                .iter()
                .map(|(name, _)| *name)
                .collect::<Vec<_>>()
                .join(", ")
        };
        let value: f64 = number.parse().map_err(|_| UnitError::NotANumber {
            text: text.to_owned(),
            quantity: name,
            units: known(),
        })?;
        let factor = match units.iter().find(|(name, _)| *name == unit) {
            Some((_, factor)) => *factor,
            None if unit.is_empty() => units.first().map_or(1.0, |(_, factor)| *factor),
            None => {
                return Err(UnitError::UnknownUnit {
                    text: text.to_owned(),
                    unit: unit.to_owned(),
                    quantity: name,
                    units: known(),
                });
            }
        };
        // Division by a round number is exact to the last digit; multiplication by its reciprocal
        // is not: 255 mm must be 0.255 m.
        let value = if factor < 1.0 && (1.0 / factor).fract() == 0.0 {
            value / (1.0 / factor)
        } else {
            value * factor
        };
        if value.is_finite() {
            Ok(value)
        } else {
            Err(UnitError::NotFinite {
                text: text.to_owned(),
            })
        }
    }
}

/// Length in bytes of the number that a text begins with; 0 if it does not.
fn number_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits = |from: usize| {
        let rest = bytes.get(from..).unwrap_or_default();
        rest.iter().take_while(|b| b.is_ascii_digit()).count()
    };
    let is = |at: usize, set: &[u8]| bytes.get(at).is_some_and(|b| set.contains(b));
    let sign = usize::from(is(0, b"+-"));
    let mut end = sign + digits(sign);
    if is(end, b".") {
        end += 1 + digits(end + 1);
    }
    if is(end, b"eE") {
        let sign = usize::from(is(end + 1, b"+-"));
        let exponent = digits(end + 1 + sign);
        // Without digits the `e` belongs to a unit, or to a mistake.
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    end
}

/// A text is not a quantity.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UnitError {
    /// It does not begin with a number.
    #[error(
        "`{text}` is not a {quantity}: write a number, with one of the units {units} or without"
    )]
    NotANumber {
        /// The text.
        text: String,
        /// What was expected.
        quantity: &'static str,
        /// The units that it may have.
        units: String,
    },
    /// Its unit is not one of the quantity's.
    #[error("`{text}`: `{unit}` is not a unit of a {quantity} here; use one of {units}")]
    UnknownUnit {
        /// The text.
        text: String,
        /// The unit in it.
        unit: String,
        /// What was expected.
        quantity: &'static str,
        /// The units that it may have.
        units: String,
    },
    /// The number is too large.
    #[error("`{text}` is too large a number")]
    NotFinite {
        /// The text.
        text: String,
    },
}

#[cfg(test)]
mod tests {
    use super::{Quantity, UnitError};
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn units_scale_to_si() {
        let cases = [
            (Quantity::Length, "255", 0.255),
            (Quantity::Length, "0.255m", 0.255),
            (Quantity::Length, "25.5 cm", 0.255),
            (Quantity::Length, "-1e3um", -0.001),
            (Quantity::Length, "1in", 0.0254),
            (Quantity::Length, "+.5m", 0.5),
            (Quantity::Length, "2.m", 2.0),
            (Quantity::Angle, "90", FRAC_PI_2),
            (Quantity::Angle, "90°", FRAC_PI_2),
            (Quantity::Angle, "100mrad", 0.1),
            (Quantity::Force, "10", 10.0),
            (Quantity::Force, "0.01kN", 10.0),
        ];
        for (quantity, text, want) in cases {
            let got = quantity.parse(text).unwrap();
            assert!((got - want).abs() <= 1e-15 * want.abs(), "{text}: {got}");
        }
    }

    #[test]
    fn millimetres_are_exact() {
        for mm in 1..2000_i32 {
            let want: f64 = format!("{mm}e-3").parse().unwrap();
            assert_eq!(Quantity::Length.parse(&mm.to_string()), Ok(want));
        }
    }

    #[test]
    fn anything_else_is_refused() {
        for text in [
            "", "m", "nan", "inf", "-", ".", "1e", "1.2.3", "5deg", "5 m m", "0x10",
        ] {
            assert!(Quantity::Length.parse(text).is_err(), "{text}");
        }
        assert!(matches!(
            Quantity::Length.parse("1e400"),
            Err(UnitError::NotFinite { .. })
        ));
        let message = Quantity::Angle.parse("3mm").unwrap_err().to_string();
        assert!(
            message.contains("`mm`") && message.contains("deg, rad"),
            "{message}"
        );
    }
}
