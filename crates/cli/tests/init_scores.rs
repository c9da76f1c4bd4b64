//! `pwrfgs init` for spectra whose lobes move, appear or cross with the transmitter: its pipeline scores above neighbours.
use crate::common::{refuse, stderr, stdout, succeed, write};
use pwrfgs::data::npy_header;
use pwrfgs_core::Number;
use std::path::Path;

const WIDTH: usize = 72;
const HEIGHT: usize = 18;
const COUNT: usize = 150;
/// Width of a lobe, radians.
const SIGMA: f64 = 0.31;

/// Direction and height of a lobe.
type Lobe = ([f64; 3], f64);
/// Lobes of a transmitter position.
type Lobes = fn([f64; 3]) -> Vec<Lobe>;

fn at(azimuth: f64, elevation: f64) -> [f64; 3] {
    let (azimuth, elevation) = (azimuth.to_radians(), elevation.to_radians());
    [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
}

fn towards([x, y, z]: [f64; 3]) -> [f64; 3] {
    let norm = (x * x + y * y + z * z).sqrt();
    [x / norm, y / norm, z / norm]
}

/// The line of sight, and its reflection at a wall.
fn moving([x, y, z]: [f64; 3]) -> Vec<Lobe> {
    vec![(towards([x, y, z]), 1.0), (towards([-4.0 - x, y, z]), 0.6)]
}

/// The line of sight, and two fixed lobes that are bright in one half of the room.
fn appearing([x, y, z]: [f64; 3]) -> Vec<Lobe> {
    let switch = |along: f64| 1.0 / (1.0 + (-3.0 * along).exp());
    vec![(towards([x, y, z]), 0.7), (at(40.0, 30.0), switch(x)), (at(160.0, 50.0), 0.8 * switch(y))]
}

/// Two lobes that pass each other.
fn crossing([x, y, _]: [f64; 3]) -> Vec<Lobe> {
    vec![(at(180.0 + 60.0 * x, 30.0 + 10.0 * y), 1.0), (at(180.0 - 60.0 * x, 30.0 - 10.0 * y), 0.8)]
}

/// Writes a folder of spectra, with transmitters spread over 4 x 3 m above the receiver.
fn folder(place: &Path, lobes: Lobes) {
    let spread = |i: usize, step: f64, from: f64, to: f64| from + (to - from) * (i as f64 * step).fract();
    let transmitters: Vec<[f64; 3]> = (1..=COUNT)
        .map(|i| [spread(i, 0.8192, -2.0, 2.0), spread(i, 0.6710, -1.5, 1.5), spread(i, 0.5497, 0.8, 1.6)])
        .collect();
    let pixel = |lobes: &[Lobe], at: [f64; 3]| {
        let lobe = |(centre, height): &Lobe| {
            let cosine: f64 = centre.iter().zip(at).map(|(a, b)| a * b).sum();
            height * ((cosine - 1.0) / (SIGMA * SIGMA)).exp()
        };
        (200.0 * lobes.iter().map(lobe).sum::<f64>()).min(255.0) as u8
    };
    let spectrum = |p: &[f64; 3]| {
        let lobes = lobes(*p);
        (0..HEIGHT * WIDTH).map(move |i| pixel(&lobes, at(5.0 * (i % WIDTH) as f64, 5.0 * (i / WIDTH) as f64)))
    };
    let pixels: Vec<u8> = transmitters.iter().flat_map(spectrum).collect();
    let positions: Vec<u8> = transmitters.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    write(&place.join("spectra.npy"), [npy_header(Number::U8, &[COUNT, HEIGHT, WIDTH]), pixels].concat());
    write(&place.join("tx.npy"), [npy_header(Number::F64, &[COUNT, 3]), positions].concat());
    write(&place.join("gateway_info.yml"), "gateway1:\n  position: [0, 0, 0]\n  orientation: [0, 0, 0, 1]\n");
}

#[test]
fn pipeline_of_init_is_ahead_of_neighbours_on_moving_lobes() {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    // One model with fewer Gaussians and without residuals, for a quick test of what the Gaussians learn.
    let short = ["--set", "residuals=None", "--set", "training.batch=8", "--set", "initializer.count=60"];
    let sets: [(&str, Lobes); 3] = [("moving", moving), ("appearing", appearing), ("crossing", crossing)];
    for (name, lobes) in sets {
        folder(&here.join(name), lobes);
        succeed(here, &["init", name, "--effort", "fast"]);
        let text = std::fs::read_to_string(here.join(format!("{name}.ron"))).unwrap();
        assert!(text.contains("k: Auto") && text.contains("Kriging("), "{text}");
        let table = stdout(&succeed(here, &[&["run", &format!("{name}.ron")][..], &short].concat()));
        let row = table.lines().find(|line| line.starts_with("ssim ")).unwrap();
        let scores: Vec<f64> = row.split_whitespace().filter_map(|cell| cell.trim_matches('*').parse().ok()).collect();
        let [model, _, one, several, _] = scores[..] else { panic!("{row}") };
        assert!(model > one.max(several) + 0.01, "{name}: {row}");
    }
}

/// The three efforts of a small set: number of models, steps and jitter follow the places.
#[test]
fn efforts_of_small_powers_are_one_eight_and_sixteen_models() {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    let powers = |i: usize| (-40.0 - 20.0 * ((1 + i % 9) as f64).log10() - (i % 7) as f64, -50.0 - (i % 11) as f64);
    let row = |i: usize| format!("{},{},1,{:.1},{:.1}\n", i % 10, i / 10, powers(i).0, powers(i).1);
    let table: String = (0..90).map(row).collect();
    write(&here.join("walk.csv"), format!("x,y,z,ap1,ap2\n{table}"));
    succeed(here, &["import", "--table", "walk.csv", "--columns", "ap*", "--out", "walk"]);
    for (effort, members, width) in [("fast", 1, 48), ("normal", 8, 48), ("best", 16, 64)] {
        let out = format!("{effort}.ron");
        let said = stdout(&succeed(here, &["init", "walk", "--effort", effort, "--out", &out]));
        assert!(said.contains("known positions are few"), "{said}");
        let text = std::fs::read_to_string(here.join(&out)).unwrap();
        for setting in ["steps: 400", "tx_jitter_m: 0.225", "residuals: Kriged(", &format!("width: {width}")] {
            assert!(text.contains(setting), "{effort}: {setting}: {text}");
        }
        assert!(text.contains(&format!("members: {members},")), "{effort}: {text}");
    }
    let table = stdout(&succeed(here, &["run", "normal.ron", "--out", "r", "-q"]));
    assert!(table.contains("share") && !table.contains("member 8"), "{table}");
    succeed(here, &["report", "r", "--out", "page"]);
    let page = std::fs::read_to_string(here.join("page/report.html")).unwrap();
    assert!(page.contains("colspan=\"1\" scope=\"colgroup\">share"), "the share is one column");
    // Positions of these receivers are estimated, in each data folder anew.
    succeed(here, &["update", "r", "--data", "walk", "--out", "updated.safetensors"]);
    let said = stderr(&succeed(here, &["map", "r", "--plane", "z=1", "--step", "2", "--out", "drawn"]));
    assert!(
        said.contains("estimated receiver positions (ap1, ap2): powers within some metres of them are unreliable"),
        "{said}"
    );
    refuse(here, &["init", "walk", "--effort", "most", "--out", "no.ron"], 2, &["fast, normal or best"]);
}

/// With so many receivers that a step has 2,500 links at few transmitters, there are half as many models.
#[test]
fn steps_with_many_links_have_fewer_models() {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    let names: Vec<String> = (0..100).map(|k| format!("ap{k}")).collect();
    let power = |i: usize, k: usize| format!("-{}", 40 + 2 * (i % 10 + i / 10) + k % 20);
    let powers = |i: usize| (0..100).map(|k| power(i, k)).collect::<Vec<_>>().join(",");
    let rows: Vec<String> = (0..60).map(|i| format!("{},{},1,{}", i % 10, i / 10, powers(i))).collect();
    write(&here.join("walk.csv"), format!("x,y,z,{}\n{}\n", names.join(","), rows.join("\n")));
    succeed(here, &["import", "--table", "walk.csv", "--columns", "ap*", "--out", "walk"]);
    succeed(here, &["init", "walk", "-o", "many.ron"]);
    let text = std::fs::read_to_string(here.join("many.ron")).unwrap();
    assert!(text.contains("batch: 27,") && text.contains("members: 4,"), "{text}");
}

/// Only the largest effort stores residuals at every pixel.
#[test]
fn residuals_of_spectra_are_exact_with_the_largest_effort() {
    let here = tempfile::tempdir().unwrap();
    let here = here.path();
    folder(&here.join("few"), moving);
    for (effort, stride) in [("normal", "stride: 4"), ("best", "stride: 1")] {
        let out = format!("{effort}.ron");
        succeed(here, &["init", "few", "--effort", effort, "-o", &out]);
        let text = std::fs::read_to_string(here.join(&out)).unwrap();
        let residuals = text.split("residuals: Kriged(").nth(1).unwrap();
        assert!(residuals[..400].contains(stride), "{effort}: {residuals}");
    }
}
