//! JSON for viewers: numbers to seven decimals.
//!
//! The wire has 0.1 um and 1 mN; the seventeen digits of a float behind them cost half of a record. What is read back
//! as numbers (the plan, what was true, the bytes of the wire) keeps every digit.

use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter, Serializer};
use std::io::{self, Write};

/// One over the last decimal.
const SCALE: f64 = 1e7;

struct Short;

impl Formatter for Short {
    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> io::Result<()> {
        let short = (value * SCALE).round() / SCALE;
        // What is too great to be scaled has no decimals.
        let value = if short.is_finite() { short } else { value };
        CompactFormatter.write_f64(writer, value)
    }
}

/// A message with numbers to seven decimals.
pub(super) fn to_vec(body: &impl Serialize) -> serde_json::Result<Vec<u8>> {
    let mut out = Vec::with_capacity(256);
    body.serialize(&mut Serializer::with_formatter(&mut out, Short))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    #[test]
    fn seven_decimals_are_kept_and_no_more() {
        let text = super::to_vec(&[
            0.374_348_199_999_999_96,
            -13.421_000_000_000_001,
            1e300,
            2.0,
        ]);
        let text = String::from_utf8(text.unwrap()).unwrap();
        assert_eq!(text, "[0.3743482,-13.421,1e+300,2.0]");
    }
}
