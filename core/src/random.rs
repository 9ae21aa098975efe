//! Random numbers from a seed.

use mcdpr_kinematics::Pose;
use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Random number generator.
#[derive(Debug)]
pub struct Random(ChaCha8Rng);

impl Random {
    /// The generator with this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        // 53 bits: as many as an f64 holds without rounding up to 1.
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `count`; 0 if that is 0.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a small count"
    )]
    pub fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }

    /// Uniform in +-half.
    pub fn within(&mut self, half: f64) -> f64 {
        (self.unit() * 2.0 - 1.0) * half
    }

    /// Normal with standard deviation 1 (Box and Muller, 1958).
    pub fn normal(&mut self) -> f64 {
        // 1 - unit lies in (0, 1]: the logarithm of zero does not occur.
        let radius = (-2.0 * libm::log(1.0 - self.unit())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }

    /// A vector with each coordinate uniform in +-half.
    pub fn point(&mut self, half: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.within(half))
    }

    /// A pose moved and turned by up to these amounts per axis.
    pub fn turned(&mut self, pose: &Pose, position_m: f64, angle_rad: f64) -> Pose {
        let (p, r) = (self.point(position_m), self.point(angle_rad));
        pose.displaced(&p, &r)
    }
}
