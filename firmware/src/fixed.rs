//! Fixed-point helpers. `q` in a name is the number of fractional bits.

/// `a * b / 2^bits`, rounded to nearest, saturated to `i32`.
///
/// ```
/// assert_eq!(mcdpr_firmware::fixed::mul_shift(3, 5 << 16, 16), 15);
/// assert_eq!(mcdpr_firmware::fixed::mul_shift(i32::MAX, 1 << 30, 1), i32::MAX);
/// ```
#[must_use]
pub fn mul_shift(a: i32, b: i64, bits: u32) -> i32 {
    saturate(i64::from(a).saturating_mul(b).saturating_add(half(bits)) >> bits)
}

/// One half in a number with `bits` fractional bits.
#[must_use]
pub const fn half(bits: u32) -> i64 {
    if bits == 0 { 0 } else { 1 << (bits - 1) }
}

/// `value * factor / 2^bits`, rounded down, exact: the product may be wider than 64 bits as long as
/// the result is not. `factor` is not negative and under 2^32, `bits` at most 31.
///
/// ```
/// assert_eq!(mcdpr_firmware::fixed::scale_down(-(1 << 50), 3 << 20, 22), -3 * (1 << 48));
/// ```
#[must_use]
pub const fn scale_down(value: i64, factor: i64, bits: u32) -> i64 {
    let low = value & ((1 << bits) - 1);
    (value >> bits) * factor + ((low * factor) >> bits)
}

/// `value / DIVISOR`, rounded towards zero. Most values fit 32 bits, and the chip divides those in
/// a few instructions; 64 bits take it a hundred and more.
///
/// ```
/// use mcdpr_firmware::fixed::quotient;
/// assert_eq!((quotient::<100>(-250), quotient::<100>(1 << 40)), (-2, (1 << 40) / 100));
/// ```
#[must_use]
#[inline]
pub fn quotient<const DIVISOR: i32>(value: i64) -> i64 {
    match i32::try_from(value) {
        Ok(value) => i64::from(value / DIVISOR),
        Err(_) => value / i64::from(DIVISOR),
    }
}

/// The nearest `i32`.
#[must_use]
pub fn saturate(value: i64) -> i32 {
    i32::try_from(value).unwrap_or(if value < 0 { i32::MIN } else { i32::MAX })
}

/// The nearest `i16`.
#[must_use]
pub fn saturate_i16(value: i32) -> i16 {
    i16::try_from(value).unwrap_or(if value < 0 { i16::MIN } else { i16::MAX })
}

/// First-order low-pass filter with its state in 1/2^16 of the input's unit.
#[derive(Debug, Clone, Copy, Default)]
pub struct LowPass {
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
    pub const fn value_q16(&self) -> i64 {
        self.state_q16
    }
}
