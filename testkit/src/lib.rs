//! What tests of all crates share: numbers from a seed, the same on every machine, and whether they take their long forms.

use nalgebra::Vector3;

/// `SUTURA_FULL=1`: tests take their long forms. `cargo xtask test --full` asks for them.
pub fn full() -> bool {
    std::env::var_os("SUTURA_FULL").is_some_and(|value| value == "1")
}

/// Numbers from a seed.
pub struct Random(fastrand::Rng);

impl Random {
    /// The same numbers for the same seed.
    pub fn new(seed: u64) -> Self {
        Self(fastrand::Rng::with_seed(seed))
    }

    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.u64(..)
    }

    /// 0 to `count`, without it; 0 below nothing.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.usize(..count.max(1))
    }

    /// 0 to 1, without it.
    pub fn unit(&mut self) -> f64 {
        self.0.f64()
    }

    /// `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// -1 to 1.
    pub fn signed(&mut self) -> f64 {
        self.between(-1.0, 1.0)
    }

    /// True in so many of all cases, 0 to 1.
    pub fn chance(&mut self, part: f64) -> bool {
        self.unit() < part
    }

    /// Each number -1 to 1, (3).
    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.signed())
    }

    /// A unit vector, as likely anywhere, (3).
    pub fn direction(&mut self) -> Vector3<f64> {
        loop {
            let v = self.vector();
            if (0.1..1.0).contains(&v.norm()) {
                return v.normalize();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Random;

    #[test]
    fn numbers_follow_from_their_seed_and_stay_where_they_belong() {
        let draw = |seed| {
            let mut random = Random::new(seed);
            std::array::from_fn::<u64, 8, _>(|_| random.bits())
        };
        assert_eq!(draw(7), draw(7));
        assert_ne!(draw(7), draw(8));
        let mut random = Random::new(1);
        let mut mean = 0.0;
        for _ in 0..10_000 {
            assert!(random.below(5) < 5);
            assert!((2.0..3.0).contains(&random.between(2.0, 3.0)));
            assert!((random.direction().norm() - 1.0).abs() < 1e-12);
            mean += random.signed() / 10_000.0;
        }
        assert!(mean.abs() < 0.03, "{mean}");
    }
}
