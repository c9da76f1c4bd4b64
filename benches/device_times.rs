//! Times whole training steps with the networks of the papers on the CPU and on the GPU, one transmitter and spectra of 90 × 360
//! pixels, as a table in Markdown. Arguments: the number of steps, by default 200, and the largest number of Gaussians, by default
//! 65,469. A row ends after five seconds. `tests/gpu.sh` runs it.
//!
//! Every time is measured in a process of its own, since a process has one device; those of a row follow each other.

#![allow(clippy::print_stdout)] // its result

use pwrfgs::core::device::{self, DeviceChoice};
use pwrfgs::core::rng;
use pwrfgs::prelude::*;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

const NETWORKS: [&str; 2] = ["Mlp()", "Wrfgs()"];
const GAUSSIANS: [usize; 3] = [157, 2613, 65_469];
const SECONDS: f64 = 5.0;

/// Returns the median time of a step, milliseconds; the first step, which allocates, is not counted if there are more.
fn step_ms(network: &str, n: usize, steps: usize) -> Result<f64> {
    let pipeline = format!(
        "Pipeline(
            name: \"times\", data: Teacher(gaussians: 20, samples: 10, width: 360, height: 90), split: Random(test: 0.2),
            initializer: Random(count: {n}, std: 3), deformation: {network}, pruners: [],
            training: (steps: 1000000, batch: 1, densify_until: 1000000, prune_until: 1000000, densify: (every: 0)),
        )"
    );
    let pipeline = Pipeline::parse(&pipeline, Path::new("times.ron"))?;
    let data = pipeline.data.load(Path::new("."), &|_, _| {})?;
    let partition = pipeline.split.split(&data, &mut rng::stream(5, "split", 0))?;
    let mut trainer = pipeline.trainer(&data, &partition)?;
    let (mut times, begun) = (Vec::new(), Instant::now());
    while times.len() < steps && (times.is_empty() || begun.elapsed().as_secs_f64() < SECONDS) {
        let (step, most) = (Instant::now(), if times.is_empty() { 1 } else { (steps - times.len()).min(50) as u64 });
        let done = trainer.run_steps(most)?.len();
        let milliseconds = 1e3 * step.elapsed().as_secs_f64() / done as f64;
        times.extend(std::iter::repeat_n(milliseconds, done));
    }
    if times.len() > 1 {
        times.remove(0);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

/// Prints the name of the device and the time of a step on it: the work of a process.
fn measure(choice: DeviceChoice, network: &str, n: usize, steps: usize) -> Result<()> {
    pwrfgs::device::select(choice)?;
    let milliseconds = step_ms(network, n, steps)?;
    println!("{milliseconds}\n{}", device::name().unwrap_or("CPU"));
    Ok(())
}

/// Returns what a process prints that measures on this device: milliseconds, and the name of the device.
fn measured(device: &str, network: &str, n: usize, steps: usize) -> Result<(f64, String), String> {
    let program = std::env::current_exe().map_err(|e| e.to_string())?;
    let [n, steps] = [n, steps].map(|number| number.to_string());
    let output = Command::new(program).args([device, network, &n, &steps]).output().map_err(|e| e.to_string())?;
    let printed = String::from_utf8_lossy(&output.stdout);
    let parts = printed.trim().split_once('\n').and_then(|(time, name)| Some((time.parse().ok()?, name.to_owned())));
    parts.ok_or_else(|| String::from_utf8_lossy(&output.stderr).into_owned())
}

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize| arguments.get(k).and_then(|text| text.parse().ok());
    if let (Some(choice), Some(network)) = (arguments.first().and_then(|text| text.parse().ok()), arguments.get(1))
        && let (Some(n), Some(steps)) = (number(2), number(3))
    {
        return measure(choice, network, n, steps).map_err(|e| e.to_string());
    }
    let (steps, most) = (number(0).unwrap_or(200), number(1).unwrap_or(usize::MAX));
    let (mut rows, mut name) = (Vec::new(), String::new());
    for network in NETWORKS {
        for n in GAUSSIANS.into_iter().filter(|n| *n <= most) {
            let (cpu, _) = measured("cpu", network, n, steps)?;
            let gpu;
            (gpu, name) = measured("gpu", network, n, steps)?;
            rows.push(format!("| `{network}` | {n} | {cpu:.2} | {gpu:.2} | {:.2} |", cpu / gpu));
        }
    }
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or(": unknown CPU");
    let (model, threads) = (model.trim_start_matches(['\t', ' ', ':']), rayon::current_num_threads());
    println!(
        "A training step, one transmitter, spectra of 90 × 360 pixels, median of up to {steps} steps, milliseconds.\n"
    );
    println!("| network | N | {model}, {threads} threads | {name} | ratio |");
    println!("|---|---|---|---|---|");
    println!("{}", rows.join("\n"));
    Ok(())
}
