//! Random streams as functions of (seed, name, step). An additional draw in one place does not affect other streams,
//! and a resumed run needs no saved state.

use crate::Real;
use rand::{Rng as _, SeedableRng};

/// Generator of all streams.
pub type Rng = rand_xoshiro::Xoshiro256PlusPlus;

/// Returns the stream `name` at `step` of the run with `seed`.
pub fn stream(seed: u64, name: &str, step: u64) -> Rng {
    // FNV-1a over the name, then SplitMix64 (inside `seed_from_u64`) spreads the bits. Odd factors keep different seeds,
    // and different steps, different.
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    let mixed = hash
        ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ step.wrapping_add(1).wrapping_mul(0xd1b5_4a32_d192_ed03).rotate_left(23);
    Rng::seed_from_u64(mixed)
}

/// Draws from the uniform distribution on [0, 1), with 53 bits.
#[inline]
pub fn uniform_f64(rng: &mut Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// Draws from the uniform distribution as [`uniform_f64`]; single precision may round the draw up to 1.
#[inline]
pub fn uniform(rng: &mut Rng) -> Real {
    uniform_f64(rng) as Real
}

/// Draws from the standard normal distribution (Box and Muller), with two uniform samples per draw.
#[inline]
pub fn normal_f64(rng: &mut Rng) -> f64 {
    let u = 1.0 - uniform_f64(rng);
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * uniform_f64(rng)).cos()
}

/// Draws from the standard normal distribution as [`normal_f64`], rounded to [`Real`].
#[inline]
pub fn normal(rng: &mut Rng) -> Real {
    normal_f64(rng) as Real
}

/// Draws uniformly from 0..n; `n` must not be 0.
#[inline]
pub fn below(rng: &mut Rng, n: usize) -> usize {
    ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize
}

/// Puts `items` in random order (Fisher and Yates).
pub fn shuffle<T>(rng: &mut Rng, items: &mut [T]) {
    for i in (1..items.len()).rev() {
        items.swap(i, below(rng, i + 1));
    }
}
