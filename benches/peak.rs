//! The largest rate of multiply-adds that this machine reaches: the floor under every time of the network.
//!
//! `cargo bench -p pwrfgs --bench peak` prints multiply-adds a second (criterion's «elements») for one thread and for
//! all. `Mlp()` costs 493,312 of them a Gaussian once what depends on the transmitter alone is shared, so N Gaussians
//! cannot take less than 493,312 N divided by that rate. `docs/lab/performance.md` holds the calculation.

use criterion::{Criterion, Throughput};
use pulp::{Arch, Simd, WithSimd};
use std::hint::black_box;

/// Independent sums: enough to hide the latency of a multiply-add on two ports, few enough for 32 registers.
const SUMS: usize = 20;
/// Multiply-adds of each sum in one call.
const ROUNDS: usize = 100_000;

/// Nothing but multiply-adds on registers, at the widest vectors of the processor.
struct MultiplyAdds;

impl WithSimd for MultiplyAdds {
    /// A sum of all, so that nothing is optimised away, and how many multiply-adds were made.
    type Output = (f32, u64);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let (scale, shift) = (simd.splat_f32s(black_box(0.999_9)), simd.splat_f32s(black_box(1e-6)));
        let mut sums = [simd.splat_f32s(black_box(1.0)); SUMS];
        for _ in 0..ROUNDS {
            for sum in &mut sums {
                *sum = simd.mul_add_f32s(*sum, scale, shift);
            }
        }
        let total = sums.iter().map(|sum| simd.reduce_sum_f32s(*sum)).sum();
        (total, (S::F32_LANES * SUMS * ROUNDS) as u64)
    }
}

fn main() {
    let mut criterion = Criterion::default().sample_size(20).configure_from_args();
    let arch = Arch::new();
    let (_, count) = arch.dispatch(MultiplyAdds);
    let mut group = criterion.benchmark_group("peak");
    group.throughput(Throughput::Elements(count));
    group.bench_function("one thread", |b| b.iter(|| arch.dispatch(MultiplyAdds)));
    let threads = rayon::current_num_threads();
    group.throughput(Throughput::Elements(count * threads as u64));
    group
        .bench_function(format!("{threads} threads"), |b| b.iter(|| rayon::broadcast(|_| arch.dispatch(MultiplyAdds))));
    group.finish();
    criterion.final_summary();
}
