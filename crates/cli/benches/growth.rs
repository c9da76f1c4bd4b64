//! Growth of processor time and memory with the data, on invented data.
//!
//! `cargo bench -p pwrfgs-cli --bench growth` runs each command at three sizes and prints one row per command: processor time,
//! peak memory, and the slopes between the outer sizes (1: linear). `-- import locate` runs these rows alone. All rows take
//! three minutes on two cores; `docs/guide.md` has the table.

#![allow(clippy::print_stdout)] // the table is its result

use std::error::Error;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use wait4::Wait4;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Command that is measured at three sizes.
struct Row {
    name: &'static str,
    unit: &'static str,
    sizes: [usize; 3],
    /// Writes what the command reads, and returns its arguments.
    prepare: fn(&Path, usize) -> Result<String>,
}

const ROWS: [Row; 13] = [
    Row { name: "import", unit: "readings", sizes: [10_000, 100_000, 1_000_000], prepare: import },
    Row { name: "inspect", unit: "receivers", sizes: [5, 50, 500], prepare: inspect },
    Row { name: "init", unit: "positions", sizes: [1_000, 10_000, 100_000], prepare: init },
    Row { name: "simulate", unit: "spectra", sizes: [100, 1_000, 10_000], prepare: simulate },
    Row { name: "step-receivers", unit: "receivers", sizes: [5, 50, 500], prepare: step_by_receivers },
    Row { name: "step-gaussians", unit: "Gaussians", sizes: [1_000, 10_000, 100_000], prepare: step_by_gaussians },
    Row { name: "score", unit: "positions", sizes: [1_000, 10_000, 100_000], prepare: score },
    Row { name: "locate", unit: "positions", sizes: [1_000, 10_000, 100_000], prepare: locate },
    Row { name: "predict", unit: "positions", sizes: [1_000, 10_000, 100_000], prepare: predict },
    Row { name: "channels", unit: "positions", sizes: [1_000, 4_000, 16_000], prepare: channels },
    Row { name: "search", unit: "MHz", sizes: [300, 600, 1_200], prepare: search },
    Row { name: "report", unit: "test positions", sizes: [100, 1_000, 10_000], prepare: report },
    Row { name: "sweep", unit: "runs", sizes: [2, 8, 32], prepare: sweep },
];

fn main() -> Result<()> {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    println!("| command | sizes | processor time, s | slope | peak memory, MB | slope |\n|---|---|---|---|---|---|");
    for row in ROWS.iter().filter(|row| wanted.is_empty() || wanted.iter().any(|name| name == row.name)) {
        let folder = tempfile::tempdir()?;
        let (mut seconds, mut bytes) = (Vec::new(), Vec::new());
        for size in row.sizes {
            let arguments = (row.prepare)(folder.path(), size)?;
            let (time, memory) = measure(folder.path(), &arguments)?;
            seconds.push(time);
            bytes.push(memory);
        }
        let slope = |values: &[f64]| (values[2] / values[0]).ln() / (row.sizes[2] as f64 / row.sizes[0] as f64).ln();
        let list = |values: &[f64], unit: f64| {
            values.iter().map(|value| format!("{:.3}", value / unit)).collect::<Vec<_>>().join(", ")
        };
        let sizes = row.sizes.map(|size| size.to_string()).join(", ");
        let (time, memory) = (list(&seconds, 1.0), list(&bytes, 1e6));
        let slopes = [&seconds, &bytes].map(|values| format!("{:.2}", slope(values)));
        println!("| {} | {sizes} {} | {time} | {} | {memory} | {} |", row.name, row.unit, slopes[0], slopes[1]);
    }
    Ok(())
}

/// Creates the command that runs the program in `folder` with `arguments`, which are separated by blanks.
fn program(folder: &Path, arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pwrfgs"));
    command.current_dir(folder).env("RUST_LOG", "error").args(arguments.split(' ')).arg("-q").stdout(Stdio::null());
    command
}

/// Runs the program unless `folder` already has its output `made`.
fn run(folder: &Path, made: &str, arguments: &str) -> Result<()> {
    if folder.join(made).exists() { Ok(()) } else { measure(folder, arguments).map(drop) }
}

/// Returns the processor time in seconds and the peak memory in bytes of a run of the program.
fn measure(folder: &Path, arguments: &str) -> Result<(f64, f64)> {
    // Warnings on the terminal would separate the rows of the table.
    let log = folder.join("stderr.txt");
    let used = program(folder, arguments).stderr(File::create(&log)?).spawn()?.wait4()?;
    if !used.status.success() {
        return Err(format!("pwrfgs {arguments} failed: {}", std::fs::read_to_string(log)?).into());
    }
    Ok(((used.rusage.utime + used.rusage.stime).as_secs_f64(), used.rusage.maxrss as f64))
}

/// Returns the position of transmitter `i` of a walk with a spacing of about 0.5 m, metres.
fn position(i: usize, positions: usize) -> [f64; 2] {
    let side = 0.5 * (positions as f64).sqrt();
    // Multiples of these numbers, modulo 1, fill a square evenly: inverse powers of the plastic number.
    [0.754_877_666_2, 0.569_840_291].map(|ratio| side * (i as f64 * ratio).fract())
}

/// Writes a table of invented powers unless it exists; returns its name, which states its size.
fn table(folder: &Path, positions: usize, receivers: usize) -> Result<String> {
    let name = format!("t{positions}x{receivers}");
    if folder.join(format!("{name}.csv")).exists() {
        return Ok(name);
    }
    let mut text = String::from("x,y,z");
    (0..receivers).try_for_each(|r| write!(text, ",ap{r}"))?;
    for i in 0..positions {
        let [x, y] = position(i, positions);
        write!(text, "\n{x:.3},{y:.3},1.2")?;
        for r in 0..receivers {
            let [a, b] = position(7 * r + 3, positions);
            let distance = (1.0 + (x - a).powi(2) + (y - b).powi(2)).sqrt();
            let fading = 4.0 * (0.9 * x + r as f64).sin() * (0.7 * y).cos() + 2.0 * ((i * 37 + r) as f64).sin();
            write!(text, ",{:.1}", -40.0 - 20.0 * distance.log10() + fading)?;
        }
    }
    std::fs::write(folder.join(format!("{name}.csv")), text)?;
    Ok(name)
}

/// Imports a table, and returns the name of its folder.
fn data(folder: &Path, positions: usize, receivers: usize) -> Result<String> {
    let name = table(folder, positions, receivers)?;
    run(folder, &name, &format!("import --table {name}.csv --out {name}"))?;
    Ok(name)
}

/// Proposes a pipeline for the smallest set, and returns arguments of a short run on another one.
fn short_run(folder: &Path, positions: usize, receivers: usize, settings: &str) -> Result<String> {
    let (first, name) = (data(folder, 1_000, receivers)?, data(folder, positions, receivers)?);
    run(folder, "p.ron", &format!("init {first} --effort fast --out p.ron"))?;
    let short = "--set training.densify_until=0 --set training.prune_until=0 --set training.validate_every=0";
    Ok(format!("run p.ron --set data.root={name} --set split=Random(test:0.1,validation:0.1) {short} {settings}"))
}

fn import(folder: &Path, readings: usize) -> Result<String> {
    let name = table(folder, readings / 5, 5)?;
    Ok(format!("import --table {name}.csv --out imported-{readings}"))
}

fn inspect(folder: &Path, receivers: usize) -> Result<String> {
    Ok(format!("inspect {}", data(folder, 1_000, receivers)?))
}

fn init(folder: &Path, positions: usize) -> Result<String> {
    Ok(format!("init {} --out {positions}.ron", data(folder, positions, 5)?))
}

#[expect(clippy::unnecessary_wraps, reason = "as the other rows")]
fn simulate(_: &Path, spectra: usize) -> Result<String> {
    Ok(format!("simulate office --samples {spectra} --npy --no-paths --points 1000 --out s{spectra}"))
}

fn step_by_receivers(folder: &Path, receivers: usize) -> Result<String> {
    std::fs::remove_file(folder.join("p.ron")).ok();
    let settings = "--set training.steps=50 --set training.batch=32 --set baselines=[] --set residuals=None";
    short_run(folder, 1_000, receivers, &format!("{settings} --out r{receivers}"))
}

fn step_by_gaussians(folder: &Path, gaussians: usize) -> Result<String> {
    let settings = "--set training.steps=10 --set training.batch=8 --set baselines=[] --set residuals=None";
    short_run(folder, 1_000, 5, &format!("{settings} --set initializer.count={gaussians} --out n{gaussians}"))
}

fn score(folder: &Path, positions: usize) -> Result<String> {
    let settings = "--set training.steps=2 --set baselines=[NearestNeighbours(k:Auto),Kriging()]";
    short_run(folder, positions, 1, &format!("{settings} --out scored-{positions}"))
}

/// Trains for two steps without baselines, and returns the name of the run.
fn trained(folder: &Path, positions: usize) -> Result<String> {
    let (name, settings) = (format!("m{positions}"), "--set training.steps=2 --set baselines=[] --set residuals=None");
    run(folder, &name, &short_run(folder, positions, 1, &format!("{settings} --out {name}"))?)?;
    Ok(name)
}

fn locate(folder: &Path, positions: usize) -> Result<String> {
    Ok(format!("locate {} --no-kriging", trained(folder, positions)?))
}

fn predict(folder: &Path, positions: usize) -> Result<String> {
    Ok(format!("predict {} --tx-csv {}.csv --out p{positions}", trained(folder, 1_000)?, table(folder, positions, 1)?))
}

/// Writes channels `[positions, 16, 64]`, 8 kB each, with their positions, and imports them.
fn channels(folder: &Path, positions: usize) -> Result<String> {
    let name = format!("c{positions}");
    // The peak memory of a child begins with that of this process, so the array is not held.
    let mut file = BufWriter::new(File::create(folder.join(format!("{name}.npy")))?);
    let header = format!("{{'descr': '<c8', 'fortran_order': False, 'shape': ({positions}, 16, 64)}}");
    let header = format!("{header:<117}\n");
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(header.len() as u16).to_le_bytes())?;
    file.write_all(header.as_bytes())?;
    for k in 0..positions * 1_024 {
        let (sin, cos) = (k as f32 * 0.37).sin_cos();
        file.write_all(&sin.to_le_bytes())?;
        file.write_all(&cos.to_le_bytes())?;
    }
    file.flush()?;
    let row = |i: usize| format!("{:.3},{:.3},1.2\n", position(i, positions)[0], position(i, positions)[1]);
    std::fs::write(folder.join("tx.csv"), format!("x,y,z\n{}", (0..positions).map(row).collect::<String>()))?;
    let antennas = (0..16).map(|k| format!("0,{},{}\n", 0.06 * f64::from(k % 4), 0.06 * f64::from(k / 4)));
    std::fs::write(folder.join("antennas.csv"), format!("x,y,z\n{}", antennas.collect::<String>()))?;
    let place = "--receiver 0,0,2 --antennas antennas.csv --carrier-hz 2.4e9 --spacing-hz 625e3";
    Ok(format!("import --channels {name}.npy --tx tx.csv {place} --accept channel-phase --out {name}"))
}

/// Simulates 200 channels at a carrier, and returns arguments of a search for two virtual transmitters.
fn search(folder: &Path, carrier_mhz: usize) -> Result<String> {
    let name = format!("f{carrier_mhz}");
    let layout = "--layout channels --samples 200 --no-paths --points 1000";
    run(folder, &name, &format!("simulate office-channel {layout} --carrier-hz {carrier_mhz}e6 --out {name}"))?;
    run(folder, &format!("{name}.ron"), &format!("init {name} --effort fast --out {name}.ron"))?;
    let settings = "--set initializer.most=2 --set training.steps=1 --set baselines=[]";
    Ok(format!("run {name}.ron {settings} --out searched-{carrier_mhz}"))
}

fn report(folder: &Path, positions: usize) -> Result<String> {
    Ok(format!("report {}", trained(folder, 10 * positions)?))
}

fn sweep(folder: &Path, runs: usize) -> Result<String> {
    let teacher = "Teacher(gaussians: 4, samples: 40, width: 48, height: 12)";
    let training = "training: (steps: 60, batch: 2, densify_until: 0, prune_until: 0)";
    let settings = "initializer: Grid(count: 8), deformation: Mlp(depth: 2, width: 16, skip: None)";
    let base = format!("Pipeline(name: \"tiny\", data: {teacher}, split: Official(), {settings}, {training})");
    std::fs::write(folder.join("tiny.ron"), base)?;
    let seeds = (0..runs).map(|seed| seed.to_string()).collect::<Vec<_>>().join(", ");
    let name = format!("w{runs}");
    std::fs::write(
        folder.join(format!("{name}.ron")),
        format!("Experiment(name: \"{name}\", base: \"tiny.ron\", seeds: [{seeds}])"),
    )?;
    Ok(format!("sweep {name}.ron --out {name}"))
}
