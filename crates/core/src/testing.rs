//! Test tools of all crates: comparison of hand-written derivatives with central differences, paths of shared data, and
//! reports of skipped tests.

use crate::files::digest;
use crate::{Real, npy::Header, rng};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the path of `name`, such as `data/s23`, in the folder of shared data: measured spectra, reference data and
/// paths. `None`, reported by [`skipped`], if it is absent. The variable `PWRFGS_SHARED` sets that folder, by default
/// `shared` next to the checkout.
pub fn shared(name: &str) -> Option<PathBuf> {
    let default_folder = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let path = std::env::var_os("PWRFGS_SHARED").map_or_else(default_folder, PathBuf::from).join(name);
    if path.exists() {
        return Some(path);
    }
    skipped(&format!("no {name} here, set PWRFGS_SHARED"));
    None
}

/// Reads shape and values, in the order of the file, of a NumPy array: floats, bytes, integers of 64 bits, booleans.
///
/// # Panics
/// For any other array.
pub fn npy(bytes: &[u8]) -> (Vec<usize>, Vec<f64>) {
    let header = Header::read(Path::new("array"), &mut &*bytes).unwrap_or_else(|e| panic!("{e}"));
    let (width, number): (usize, fn([u8; 8]) -> f64) = match header.descr.as_str() {
        "<f4" => (4, |b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))),
        "<f8" => (8, f64::from_le_bytes),
        "<u8" => (8, |b| u64::from_le_bytes(b) as f64),
        "<i8" => (8, |b| i64::from_le_bytes(b) as f64),
        "|u1" | "|b1" => (1, |b| f64::from(b[0])),
        other => panic!("numbers of type {other}"),
    };
    let padded = |raw: &[u8]| std::array::from_fn(|k| raw.get(k).copied().unwrap_or(0));
    let values = bytes[header.offset as usize..].chunks_exact(width).map(|raw| number(padded(raw))).collect();
    (header.shape, values)
}

/// Reports that the calling test is skipped, with the reason: on the terminal, where cargo hides nothing, and as a line
/// at the end of the file in the variable `PWRFGS_SKIPPED`, if set. `tests/all.sh` counts those lines.
pub fn skipped(reason: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    let line = format!("skipped: {test}: {reason}\n");
    std::io::stderr().write_all(line.as_bytes()).expect("stderr can be written");
    if let Some(list) = std::env::var_os("PWRFGS_SKIPPED") {
        let list = OpenOptions::new().append(true).create(true).open(list);
        list.and_then(|mut list| list.write_all(line.as_bytes())).expect("PWRFGS_SKIPPED names a file");
    }
}

/// Asserts that the calling test, whose name is `test`, computes the same bits of `numbers` in another process.
#[expect(clippy::print_stdout, reason = "the other process prints its digest")]
pub fn check_bits_in_another_process(test: &str, numbers: impl IntoIterator<Item = Real>) {
    let bytes: Vec<u8> = numbers.into_iter().flat_map(Real::to_le_bytes).collect();
    let digest = digest(&bytes);
    println!("digest {digest}");
    if std::env::var_os("PWRFGS_DIGEST").is_some() {
        return;
    }
    let program = std::env::current_exe().expect("the test has a path");
    let output = Command::new(program).args([test, "--exact", "--nocapture"]).env("PWRFGS_DIGEST", "1").output();
    let printed = String::from_utf8(output.expect("the test runs again").stdout).expect("text");
    assert!(printed.contains(&format!("digest {digest}")), "{printed}");
}

/// Asserts that `vjp` is the derivative of `f` at `x`. For a random cotangent d, ∂⟨d, f(x)⟩/∂xₖ by central differences
/// with step `h` must agree with `vjp(x, d)ₖ` to `tolerance` times the largest of both values and 1 % of the largest
/// component of `vjp`. Use the f64 build: differences in single precision are inaccurate.
pub fn check_vjp(
    name: &str,
    x: &[Real],
    f: impl Fn(&[Real]) -> Vec<Real>,
    vjp: impl Fn(&[Real], &[Real]) -> Vec<Real>,
    h: Real,
    tolerance: Real,
) {
    let mut random = rng::stream(0, name, 0);
    let d: Vec<Real> = (0..f(x).len()).map(|_| rng::normal(&mut random)).collect();
    let analytic = vjp(x, &d);
    assert_eq!(analytic.len(), x.len(), "{name}: one derivative per input");
    let along = |x: &[Real]| -> Real { f(x).iter().zip(&d).map(|(f, d)| f * d).sum() };
    let largest = analytic.iter().fold(0.0, |m: Real, g| m.max(g.abs()));
    for k in 0..x.len() {
        let (mut up, mut down) = (x.to_vec(), x.to_vec());
        up[k] += h;
        down[k] -= h;
        let numeric = (along(&up) - along(&down)) / (2.0 * h);
        // The least scale accepts rounding errors where all derivatives are 0.
        let scale = numeric.abs().max(analytic[k].abs()).max(0.01 * largest).max(1e-12);
        assert!(
            (numeric - analytic[k]).abs() <= tolerance * scale,
            "{name}: input {k}: central difference {numeric}, derivative {}",
            analytic[k]
        );
    }
}
