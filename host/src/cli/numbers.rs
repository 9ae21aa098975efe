//! Numbers on the command line, for clap's `value_parser`: invalid ones are refused before anything
//! begins.

use crate::units::Quantity;

/// A finite number.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err("not finite".to_owned())
    }
}

/// A length with or without a unit (mm without); in mm.
pub(crate) fn length_mm(text: &str) -> Result<f64, String> {
    let length_m = Quantity::Length.parse(text);
    length_m.map(|m| m * 1e3).map_err(|error| error.to_string())
}

/// Above zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    (value > 0.0)
        .then_some(value)
        .ok_or_else(|| "must be above 0".to_owned())
}

/// A whole number from `LEAST` to `MOST`.
pub(crate) fn whole<const LEAST: usize, const MOST: usize>(text: &str) -> Result<usize, String> {
    let value: usize = text
        .parse()
        .map_err(|_| format!("not a whole number from {LEAST} to {MOST}"))?;
    (LEAST..=MOST)
        .contains(&value)
        .then_some(value)
        .ok_or_else(|| format!("must be {LEAST} to {MOST}"))
}

/// Zero or more.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    (value >= 0.0)
        .then_some(value)
        .ok_or_else(|| "must be 0 or more".to_owned())
}

/// A share from 0 to 1.
pub(crate) fn part(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    (0.0..=1.0)
        .contains(&value)
        .then_some(value)
        .ok_or_else(|| "must be within 0 and 1".to_owned())
}

/// A relative error, with either sign.
pub(crate) fn small(text: &str) -> Result<f64, String> {
    let value = finite(text)?;
    (value.abs() <= 0.5)
        .then_some(value)
        .ok_or_else(|| "must be within -0.5 and 0.5".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_of_its_kind_is_refused() {
        for text in ["nan", "inf", "-inf", "1,5", "", "x"] {
            for parse in [positive, not_negative, part, small] {
                assert!(parse(text).is_err(), "{text}");
            }
        }
        assert!(positive("0").is_err() && positive("1e-9").is_ok());
        assert!(not_negative("-1e-9").is_err() && not_negative("0").is_ok());
        assert!(part("1.01").is_err() && part("-0.01").is_err() && part("1").is_ok());
        let three = whole::<1, 3>;
        assert!(three("0").is_err() && three("4").is_err() && three("-1").is_err());
        assert_eq!(three("3"), Ok(3));
        assert!(small("-0.6").is_err() && small("-0.5").is_ok());
    }
}
