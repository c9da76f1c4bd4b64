//! The programs in `examples/`. Cargo builds them with the tests of this package.

use std::path::Path;
use std::process::Command;

/// What the example prints, run in `folder`.
fn run(folder: &Path, name: &str, arguments: &[&str]) -> String {
    let own = std::env::current_exe().unwrap();
    let program = own.ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(program.exists(), "{} is missing; `cargo test -p pwrfgs` builds it", program.display());
    let output = Command::new(program).args(arguments).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The numbers of a line.
fn numbers(line: &str) -> Vec<f64> {
    line.split([' ', ',']).filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn trains_on_arrays_in_memory_and_predicts_many_positions() {
    let folder = tempfile::tempdir().unwrap();
    let curve = run(folder.path(), "train", &["room.safetensors"]);
    let losses: Vec<f64> = curve.lines().filter(|l| l.contains("loss")).map(|l| numbers(l)[2]).collect();
    assert!(losses.len() == 30 && losses[29] < losses[0] / 4.0, "{curve}");
    let [model, floor] = numbers(curve.lines().last().unwrap())[..] else { panic!("{curve}") };
    assert!(model > 0.93 && model > floor + 0.1, "{curve}");

    let message = run(folder.path(), "predict", &["room.safetensors", "spectra.npy"]);
    assert!(message.ends_with("spectra.npy: 100 spectra of 24 rows and 90 columns\n"), "{message}");
    let (shape, spectra) = pwrfgs::core::testing::npy(&std::fs::read(folder.path().join("spectra.npy")).unwrap());
    assert_eq!(shape, [100, 24, 90]);
    let model = pwrfgs::model::file::read(&folder.path().join("room.safetensors")).unwrap();
    let pixels: Vec<f64> = model.predict([0.3, 0.5, 1.0]).pixels.iter().map(|v| f64::from(*v as f32)).collect();
    assert_eq!(spectra[..24 * 90], pixels);
}

#[test]
fn custom_cloud_is_drawn_and_differentiated() {
    let folder = tempfile::tempdir().unwrap();
    let message = run(folder.path(), "render", &["room.png"]);
    assert_eq!(image::image_dimensions(folder.path().join("room.png")).unwrap(), (360, 90));
    let derivatives: Vec<Vec<f64>> = message.lines().skip(1).map(numbers).collect();
    assert_eq!(derivatives.len(), 2, "{message}");
    for pair in derivatives {
        let (exact, by_difference) = (pair[0], pair[1]);
        assert!(exact != 0.0 && (exact - by_difference).abs() < 0.01 * exact.abs() + 2e-4, "{message}");
    }
}
