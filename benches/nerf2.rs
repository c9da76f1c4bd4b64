//! NeRF2 at its full size: what the trunk costs once, a spectrum after that, several without anything kept, and a step.
//!
//! `RAYON_NUM_THREADS=2 cargo bench -p pwrfgs --bench nerf2` takes some three minutes and 3 GB. Each line has the arithmetic
//! beside the time; `--bench peak` says what the machine could do. The word `step` after `--` leaves the rest out. What the numbers were is in `docs/lab/nerf2.md`.

#![allow(clippy::print_stdout)] // what it prints is what it is for

use pwrfgs::core::{
    Call, GaussianCloud, Link, LinkInputs, MeasurementSetup, MethodVjp, Origin, Parameters, PixelSubset, Pose,
    Projector, WantedInputs, rng,
};
use pwrfgs::prelude::*;
use std::time::Instant;

const RAYS: usize = 8_192;
/// Multiply-adds of a sample: all of it, and what is left once the trunk is known.
const WHOLE: f64 = 687_872.0;
const LEFT: f64 = 256.0 * 128.0 + 128.0 * 2.0;

fn main() {
    let method: Plugin<dyn Method> = Plugin::parse("Nerf2()").expect("a plugin");
    let bare: Plugin<dyn Method> = Plugin::parse("Nerf2(cache_mb: 0)").expect("a plugin");
    let plane = Plugin::<dyn Projector>::parse("Mercator()").expect("a plugin").plane(360, 90);
    let setup = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane);
    let (weights, cloud) = (method.layout(&setup).init(&mut rng::stream(1, "weights", 0)), GaussianCloud::zeros(0));
    let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights: &weights };
    let random = &mut rng::stream(2, "transmitters", 0);
    let conditions: Vec<Real> = (0..3 * RAYS).map(|_| rng::normal(random)).collect();
    let links: Vec<Link> = (0..RAYS).map(|location| Link { location, receiver: 0 }).collect();
    let some = |count: usize| LinkInputs {
        values: conditions[..3 * count].to_vec(),
        pairs: links[..count].to_vec(),
        ..LinkInputs::of(3, &setup)
    };
    let [all, one, five] = [RAYS, 1, 5].map(some);
    let call = |links| Call { setup: &setup, parameters, links, pixels: &PixelSubset::All };
    let samples = 360.0 * 90.0 * 64.0;

    if std::env::args().any(|word| word == "step") {
        return step(&method, &call(&all), random);
    }
    // What cannot show is left out, and with fresh weights nothing is hidden: this is the most that it takes.
    let (ready, seconds) = timed(1, || method.prepare(&setup, &parameters));
    print_time("what no transmitter changes, once", seconds, samples * (WHOLE - LEFT));
    let (_, seconds) = timed(5, || method.predict(&call(&one), &ready));
    print_time("a spectrum after that", seconds, samples * LEFT);
    drop(ready);
    let (_, of_one) = timed(1, || bare.predict(&call(&one), &None));
    print_time("a spectrum, nothing kept", of_one, samples * WHOLE);
    let (_, of_five) = timed(1, || bare.predict(&call(&five), &None));
    print_time("each further one of five", (of_five - of_one) / 4.0, samples * LEFT);

    step(&method, &call(&all), random);
}

/// Forward and back over random rays of as many spectra.
fn step(method: &Plugin<dyn Method>, call: &Call<'_>, random: &mut rng::Rng) {
    let pixels: Vec<usize> = (0..RAYS).map(|_| rng::below(random, call.setup.value_count())).collect();
    let most = method.cost(call.setup, RAYS, 1).links_at_once;
    let (_, seconds) = timed(3, || {
        let mut sums = MethodVjp::zeros(call, WantedInputs::default());
        for (links, pixels) in call.links.pairs.chunks(most).zip(pixels.chunks(most)) {
            let links = &LinkInputs { pairs: links.to_vec(), ..call.links.clone() };
            let part = Call { links, pixels: &PixelSubset::Each(pixels.into()), ..*call };
            let observed = method.forward(&part, &None);
            let d = observed.numbers.clone();
            method.vjp(&part, observed, &d, &mut sums);
        }
        sums.weights
    });
    print_time("a step of 8,192 rays", seconds, 3.0 * RAYS as f64 * 64.0 * WHOLE);
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or(" unknown");
    println!("most memory: {}", peak.trim());
}

/// The median of some runs, after one that does not count where there are several.
fn timed<T>(runs: usize, mut run: impl FnMut() -> T) -> (T, f64) {
    let mut seconds = Vec::new();
    if runs > 1 {
        drop(run());
    }
    loop {
        let start = Instant::now();
        let out = run();
        seconds.push(start.elapsed().as_secs_f64());
        if seconds.len() == runs {
            seconds.sort_by(f64::total_cmp);
            return (out, seconds[runs / 2]);
        }
    }
}

fn print_time(what: &str, seconds: f64, products: f64) {
    println!("{what:<36} {seconds:8.3} s, {:6.1} · 10⁹ multiply-adds a second", products / seconds / 1e9);
}
