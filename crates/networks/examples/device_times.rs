//! Times the networks forward and backward on the CPU and then on the GPU, one transmitter, as a table in Markdown.
//! Arguments: the number of steps, by default 200, and the largest number of Gaussians, by default 65,469. A row ends after five
//! seconds. `tests/gpu.sh` runs it.

#![allow(clippy::print_stdout)] // its result

use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::{Deformation, DeformationInputs, DeformationVjp, Plugin, Pose, Real, rng};
use pwrfgs_networks as _;
use std::time::Instant;

const NETWORKS: [&str; 2] = ["Mlp()", "Wrfgs()"];
const GAUSSIANS: [usize; 3] = [157, 2613, 65_469];
const SECONDS: f64 = 5.0;

/// Returns the median time of a step, milliseconds; the first step is not counted if there are more.
fn step_ms(name: &str, n: usize, steps: usize) -> Result<f64, String> {
    let network = Plugin::<dyn Deformation>::parse(name)?;
    let random = &mut rng::stream(1, "times", 0);
    let weights = network.layout().init(random);
    let means: Vec<[Real; 3]> = (0..n).map(|_| std::array::from_fn(|_| 6.0 * rng::uniform(random))).collect();
    let (txs, pose) = ([[1.0, 2.0, 1.5]], Pose::IDENTITY);
    let mut times = Vec::new();
    let begun = Instant::now();
    while times.len() < steps && (times.is_empty() || begun.elapsed().as_secs_f64() < SECONDS) {
        let step = Instant::now();
        let inputs = DeformationInputs::new(&weights, &means, &txs, &pose);
        let (terms, kept) = network.forward_for_vjp(&inputs);
        let mut d_weights = vec![0.0; weights.len()];
        let inputs = DeformationInputs { kept: &kept, ..inputs };
        network.vjp(&inputs, &terms, DeformationVjp::of_weights(&mut d_weights));
        device::check().map_err(|e| e.to_string())?;
        times.push(1e3 * step.elapsed().as_secs_f64());
    }
    if times.len() > 1 {
        times.remove(0);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

fn main() -> Result<(), String> {
    let argument = |k| std::env::args().nth(k).and_then(|text| text.parse().ok());
    let (steps, most) = (argument(1).unwrap_or(200), argument(2).unwrap_or(usize::MAX));
    let gaussians = GAUSSIANS.into_iter().filter(|n| *n <= most);
    let cases: Vec<(&str, usize)> = NETWORKS.iter().flat_map(|name| gaussians.clone().map(|n| (*name, n))).collect();
    let all = || cases.iter().map(|(name, n)| step_ms(name, *n, steps)).collect::<Result<Vec<f64>, String>>();
    let cpu = all()?;
    pwrfgs_gpu::select(DeviceChoice::Gpu).map_err(|e| e.to_string())?;
    let gpu = all()?;
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or(": unknown CPU");
    let (model, threads) = (model.trim_start_matches(['\t', ' ', ':']), rayon::current_num_threads());
    println!("A network forward and backward, one transmitter, median of up to {steps} steps, milliseconds.\n");
    println!("| network | N | {model}, {threads} threads | {} | ratio |", device::name().unwrap_or("GPU"));
    println!("|---|---|---|---|---|");
    for ((name, n), (cpu, gpu)) in cases.iter().zip(cpu.iter().zip(&gpu)) {
        println!("| `{name}` | {n} | {cpu:.2} | {gpu:.2} | {:.2} |", cpu / gpu);
    }
    Ok(())
}
