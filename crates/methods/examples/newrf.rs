//! Table of `NeWRF`'s conference room: number of virtual transmitters, search time and SNR.
//!
//! `PWRFGS_SHARED=../shared cargo run --release -p pwrfgs-methods --example newrf -- 433 928 2400`
//!
//! Environment variables set the options: see `read_options`. `VERBOSE` prints the progress and the sources.

#![allow(clippy::print_stdout, clippy::print_stderr, clippy::unwrap_used, clippy::disallowed_methods)] // a table for developers

use pwrfgs_core::{Real, SPEED_OF_LIGHT, testing::shared};
use pwrfgs_methods::MatchingPursuit;
use pwrfgs_methods::virtual_transmitters::{
    ChannelInputs, PursuitOptions, VirtualSources, field, pursue_sources, snr_db,
};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Measurements of one band: carrier frequency (Hz), and per position (metres) the channel.
struct Band {
    frequency: f64,
    positions: Vec<[Real; 3]>,
    channel: Vec<[Real; 2]>,
}

/// Reads a band by the name of its files, the frequency in MHz.
fn read_band(name: &str) -> Band {
    let folder = shared("data/newrf").expect("`PWRFGS_SHARED` names the folder of the data");
    let frequency = match name {
        "2400" => 2.412e9,
        name => name.parse::<f64>().unwrap() * 1e6,
    };
    let positions = if name == "433" { "csi_433MHz_pos.csv" } else { "tx_pos.csv" };
    let mut reader = csv::Reader::from_path(folder.join(positions)).unwrap();
    let positions = reader.deserialize::<[Real; 3]>().map(Result::unwrap).collect();
    let bytes = std::fs::read(folder.join(format!("csi_{name}MHz.npy"))).unwrap();
    // complex64 after the header, whose length is in bytes 8 and 9.
    let start = 10 + u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
    let floats: Vec<Real> = bytes[start..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b) as Real).collect();
    Band { frequency, positions, channel: floats.as_chunks::<2>().0.to_vec() }
}

/// Reads the options of a search from environment variables, such as `MOST`; other options have their defaults.
fn read_options() -> PursuitOptions {
    let set = |name: &str, default: f64| std::env::var(name).map_or(default, |v| v.parse().unwrap());
    let default = MatchingPursuit::default();
    let settings = MatchingPursuit {
        reach: set("REACH", default.reach),
        step: set("STEP", default.step),
        most: set("MOST", default.most as f64) as usize,
        patience: set("PATIENCE", default.patience as f64) as usize,
        hold_out: set("HOLD", default.hold_out as f64) as usize,
        ridge: set("RIDGE", default.ridge),
        images: set("IMAGES", 1.0) > 0.0,
        rounds: set("ROUNDS", default.rounds as f64) as usize,
        ..default
    };
    let default = PursuitOptions::default();
    PursuitOptions {
        settings,
        peaks: set("PEAKS", default.peaks as f64) as usize,
        order: set("ORDER", 0.0) as usize,
        seed: set("SEED", 0.0) as u64,
        ..default
    }
}

fn main() {
    let (options, verbose) = (read_options(), std::env::var_os("VERBOSE").is_some());
    for name in std::env::args().skip(1) {
        let band = read_band(&name);
        let train = band.positions.len() - band.positions.len() / 5; // the last fifth is the test set
        let frequencies = [band.frequency];
        let links = |p| ChannelInputs { positions: p, antennas: &[[0.0; 3]], frequencies: &frequencies };
        let (before, after) = band.positions.split_at(train);
        let (h, h_after) = band.channel.split_at(train);
        let each: Vec<&[[Real; 2]]> = h.chunks(1).collect();
        let start = Instant::now();
        let mut report_progress = |sources| {
            if verbose {
                eprintln!("{:6.1} s {sources} sources", start.elapsed().as_secs_f64());
            }
        };
        let sources =
            pursue_sources(&links(before), &each, &options, &AtomicBool::new(false), &mut report_progress).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let cloud = sources.to_cloud();
        let fitted = snr_db(&field(&cloud, None, &links(before)), h);
        let test = snr_db(&field(&cloud, None, &links(after)), h_after);
        println!(
            "{name} seed {}: {} sources, {seconds:.1} s, training {fitted:.2} dB, test {test:.2} dB",
            options.seed,
            sources.len()
        );
        if verbose {
            print_sources(&sources, band.frequency);
        }
    }
}

/// Prints position, gain and phase of each source; a gain of 1 is that of free space at `frequency`.
fn print_sources(sources: &VirtualSources, frequency: f64) {
    let unit = SPEED_OF_LIGHT / frequency / (4.0 * std::f64::consts::PI);
    for (g, [x, y, z]) in sources.positions.iter().enumerate() {
        let [re, im] = sources.source_gains(g)[0];
        println!("  {x:7.3} {y:7.3} {z:7.3}  |s| {:.3} arg {:.2}", re.hypot(im) / unit, im.atan2(re));
    }
}
