//! Fixed-point helpers. `q` in a name is the number of fractional bits.

/// `a * b / 2^32`, rounded to nearest, saturated to `i32`. `b` is under 2^62 in size.
///
/// The chip multiplies 32 by 32 bits to 64 in one instruction: `b` is taken in two halves, so that
/// no product is wider.
#[must_use]
#[inline]
pub(crate) const fn mul_q32(a: i32, b: i64) -> i32 {
    // The half is added below the binary point only: `high` has no fraction.
    let (high, low) = products(a, b);
    saturate(high + ((low + half(32)) >> 32))
}

/// `a * b / 2^32`, rounded down. `b` is under 2^62 in size.
#[must_use]
#[inline]
pub(crate) const fn floor_q32(a: i32, b: i64) -> i64 {
    let (high, low) = products(a, b);
    high + (low >> 32)
}

/// `a` times the upper and the lower half of `b`: the product is `high * 2^32 + low`.
#[inline]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "halves of a number are meant"
)]
pub(crate) const fn products(a: i32, b: i64) -> (i64, i64) {
    let a = a as i64;
    (a * ((b >> 32) as i32 as i64), a * (b as u32 as i64))
}

/// One half in a number with `bits` fractional bits.
#[must_use]
pub const fn half(bits: u32) -> i64 {
    if bits == 0 { 0 } else { 1 << (bits - 1) }
}

/// `value * factor / 2^bits`, rounded down, exact: the product may be wider than 64 bits as long as
/// the result is not. `factor` is not negative and under 2^32, `bits` at most 31.
#[must_use]
pub(crate) const fn scale_down(value: i64, factor: i64, bits: u32) -> i64 {
    // Split before multiplying: neither partial product is wider than 64 bits.
    let low = value & ((1 << bits) - 1);
    (value >> bits) * factor + ((low * factor) >> bits)
}

/// `value / DIVISOR`, rounded towards zero; `DIVISOR` is positive and, without its factors of two,
/// under 2^15. Most values fit 32 bits, and the chip divides those in one instruction; [`division`]
/// takes it a hundred and more.
#[must_use]
#[inline]
pub(crate) const fn quotient<const DIVISOR: i32>(value: i64) -> i64 {
    // The remainder with another digit of 16 bits must fit 31 bits.
    const { assert!(DIVISOR > 0 && DIVISOR >> DIVISOR.trailing_zeros() < 1 << 15) };
    match narrow(value) {
        Some(value) => (value / DIVISOR) as i64,
        None => long_division(
            value,
            const { (DIVISOR >> DIVISOR.trailing_zeros()).cast_unsigned() },
            DIVISOR.trailing_zeros(),
        ),
    }
}

/// `value / (divisor * 2^twos)`, rounded towards zero, digit by digit of 16 bits, as on paper.
/// `divisor` is under 2^15.
#[inline(never)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "parts of a number are meant"
)]
const fn long_division(value: i64, divisor: u32, twos: u32) -> i64 {
    // Factors of two are shifted out first: they would cost digits of the divisor.
    let size = value.unsigned_abs() >> twos;
    let (high, low) = ((size >> 32) as u32, size as u32);
    // The remainder is below the divisor: with another digit it fits 31 bits.
    let top = high / divisor;
    let rest = ((high % divisor) << 16) | (low >> 16);
    let middle = rest / divisor;
    let rest = ((rest % divisor) << 16) | (low & 0xFFFF);
    let bottom = rest / divisor;
    let found = ((top as u64) << 32) + ((middle as u64) << 16) + bottom as u64;
    if value < 0 {
        found.wrapping_neg().cast_signed()
    } else {
        found.cast_signed()
    }
}

/// `value / divisor`, rounded towards zero; of a divisor wider than 24 bits only the upper 24
/// count, so that the quotient is accurate to 1 in 2^22. The chip divides 32 bits by 32: eight bits
/// of the value are processed at once, as in long division. The library's division of 64 bits would
/// take a kilobyte of its flash.
///
/// # Panics
/// For a divisor of 0.
#[must_use]
#[inline(never)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "parts of a number are meant"
)]
pub(crate) const fn division(value: i64, divisor: i64) -> i64 {
    let (mut size, mut by) = (value.unsigned_abs(), divisor.unsigned_abs());
    // Both are halved: the quotient stays, and the divisor leaves room for eight bits of the next
    // digit.
    while by >> 24 != 0 {
        (size, by) = (size >> 1, by >> 1);
    }
    let by = by as u32;
    let (mut left, mut rest, mut found) = (u64::BITS / 8, 0, 0);
    while left > 0 {
        // Below the divisor, the remainder leaves room for eight bits.
        rest = (rest << 8) | (size >> 56) as u32;
        size <<= 8;
        found = (found << 8) + (rest / by) as u64;
        rest %= by;
        left -= 1;
    }
    let found = found.cast_signed();
    if (value < 0) == (divisor < 0) {
        found
    } else {
        found.wrapping_neg()
    }
}

/// The value as 32 bits, if it fits.
#[inline]
#[expect(
    clippy::cast_possible_truncation,
    reason = "what is cut off is looked at"
)]
pub(crate) const fn narrow(value: i64) -> Option<i32> {
    let low = value as i32;
    // It fits if the upper word is the sign of the lower one.
    if (value >> 32) as i32 == low >> 31 {
        Some(low)
    } else {
        None
    }
}

/// The nearest `i32`.
#[must_use]
#[inline]
pub(crate) const fn saturate(value: i64) -> i32 {
    match narrow(value) {
        Some(value) => value,
        None => beyond(value),
    }
}

/// The bound that a value exceeds. Out of line: otherwise the compiler compares every value with
/// both bounds in 64 bits, which takes the chip three times as long.
#[cold]
#[inline(never)]
const fn beyond(value: i64) -> i32 {
    if value < 0 { i32::MIN } else { i32::MAX }
}

/// The nearest `i16`.
#[must_use]
pub(crate) fn saturate_i16(value: i32) -> i16 {
    i16::try_from(value).unwrap_or(if value < 0 { i16::MIN } else { i16::MAX })
}

/// First-order low-pass filter with its state in 1/2^16 of the input's unit.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LowPass {
    state_q16: i64,
}

impl LowPass {
    /// A filter that rests at `value`.
    #[must_use]
    pub const fn at(value: i32) -> Self {
        Self {
            state_q16: (value as i64) << 16,
        }
    }

    /// Takes a sample; `alpha_q16` in 0..=65536 is the share of the new sample.
    pub fn update(&mut self, value: i32, alpha_q16: i32) -> i32 {
        // In two products: error times alpha may be wider than 64 bits, and its fraction must not
        // be lost, or the state would stop short of its input.
        let error = (i64::from(value) << 16) - self.state_q16;
        self.state_q16 += (error >> 16) * i64::from(alpha_q16)
            + (((error & 0xFFFF) * i64::from(alpha_q16)) >> 16);
        self.value()
    }

    /// The filtered value.
    #[must_use]
    pub fn value(&self) -> i32 {
        saturate((self.state_q16 + half(16)) >> 16)
    }

    /// The filtered value with 16 fractional bits.
    #[must_use]
    pub(crate) const fn value_q16(&self) -> i64 {
        self.state_q16
    }
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "under 63")]
mod tests {
    use super::*;

    /// Splitmix64, with sizes of 1 to 63 bits.
    fn sized(state: &mut u64, at_least: u32) -> i64 {
        *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        let bits = 1 + at_least + (z % u64::from(63 - at_least)) as u32;
        let size = (z >> (64 - bits)) | 1 << (bits - 1);
        if *state & 1 == 0 {
            -size.cast_signed()
        } else {
            size.cast_signed()
        }
    }

    #[test]
    fn values_are_rounded_and_bounded_as_described() {
        assert_eq!(mul_q32(3, 5 << 32), 15);
        assert_eq!(mul_q32(-3, 1 << 31), -1);
        assert_eq!(mul_q32(i32::MAX, 1 << 33), i32::MAX);
        assert_eq!(floor_q32(-3, 1 << 31), -2);
        assert_eq!(scale_down(-(1 << 50), 3 << 20, 22), -3 * (1 << 48));
        assert_eq!(
            (quotient::<100>(-250), quotient::<100>(1 << 40)),
            (-2, (1 << 40) / 100)
        );
        assert_eq!(quotient::<1_000_000>(i64::MIN), i64::MIN / 1_000_000);
        assert_eq!(
            (division(-7, 2), division(7, -2), division(-7, -2)),
            (-3, -3, 3)
        );
        assert_eq!(division(i64::MIN, 49_766), i64::MIN / 49_766);
        assert_eq!(
            (saturate(-7), saturate(1 << 31), saturate(-1 << 40)),
            (-7, i32::MAX, i32::MIN)
        );
        assert_eq!(
            [-7, 40_000, -40_000].map(saturate_i16),
            [-7, i16::MAX, i16::MIN]
        );
    }

    #[test]
    fn a_division_by_24_bits_is_exact() {
        let mut state = 1;
        for _ in 0..100_000 {
            let (value, divisor) = (sized(&mut state, 0), sized(&mut state, 40) >> 40);
            if divisor != 0 && divisor.unsigned_abs() < 1 << 24 {
                assert_eq!(
                    division(value, divisor),
                    value / divisor,
                    "{value} by {divisor}"
                );
            }
        }
        for divisor in [1, -1, 2, 3, (1 << 24) - 1, 1 - (1 << 24)] {
            for value in [0, 1, -1, i64::MAX, i64::MIN + 1] {
                assert_eq!(division(value, divisor), value / divisor);
            }
        }
    }

    #[test]
    fn a_division_by_more_is_good_to_one_in_two_to_the_22() {
        let mut state = 2;
        for _ in 0..100_000 {
            let (value, divisor) = (sized(&mut state, 0), sized(&mut state, 24));
            let (found, truth) = (division(value, divisor), value / divisor);
            let most = 1 + (truth.unsigned_abs() >> 22);
            assert!(
                found.abs_diff(truth) <= most,
                "{value} by {divisor}: {found}"
            );
        }
    }
}
