//! Random streams: a stream is a function of (seed, name, step), so a draw added in one place shifts no other, and a
//! resumed run continues without any saved state.

use crate::Real;
use rand::{Rng as _, SeedableRng};

/// The generator of every stream.
pub type Rng = rand_xoshiro::Xoshiro256PlusPlus;

/// The stream called `name` at `step` of the run with `seed`.
pub fn stream(seed: u64, name: &str, step: u64) -> Rng {
    // FNV-1a over the name, then SplitMix64 (inside `seed_from_u64`) spreads the bits.
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    let mixed = hash
        ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ step.wrapping_add(1).wrapping_mul(0xd1b5_4a32_d192_ed03).rotate_left(23);
    Rng::seed_from_u64(mixed)
}

/// Uniform in [0, 1), with 53 bits; the same draw in both precisions.
#[inline]
pub fn uniform(rng: &mut Rng) -> Real {
    ((rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64) as Real
}

/// Standard normal (Box and Muller), two uniforms a draw.
#[inline]
pub fn normal(rng: &mut Rng) -> Real {
    let u = 1.0 - (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let v = (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    ((-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()) as Real
}

/// Uniform among 0..n; `n` must not be 0.
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
