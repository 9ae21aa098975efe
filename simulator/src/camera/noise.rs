//! Random numbers for whole pictures: one stream a row, so that rows can be made in parallel.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Random numbers of one row of one picture.
pub(super) struct RowNoise(ChaCha8Rng);

impl RowNoise {
    pub(super) fn new(seed: u64, row: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(row as u64);
        Self(rng)
    }

    /// Roughly normal with standard deviation 1: the sum of four uniform numbers.
    pub(super) fn normal(&mut self) -> f64 {
        let bits = self.0.next_u64();
        let sum: u64 = (0..4).map(|k| bits >> (16 * k) & 0xFFFF).sum();
        // Four uniform numbers have the variance 4 / 12: times sqrt(3) it is 1.
        (sum as f64 / 65_535.0 - 2.0) * 1.732_050_807_568_877_2
    }

    /// Uniform from 0 to 1.
    pub(super) fn uniform(&mut self) -> f64 {
        f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_deviation_it_claims_and_repeats() {
        let draw = |row| {
            let mut noise = RowNoise::new(5, row);
            (0..20_000).map(|_| noise.normal()).collect::<Vec<_>>()
        };
        let values = draw(3);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.03 && (square - 1.0).abs() < 0.05);
        assert_eq!(values, draw(3));
        assert_ne!(values, draw(4));
    }
}
