//! Models with Kriged residuals in every command, and resumed runs.
use crate::common::{SMALL, call, measured, picture, pwrfgs, refuse, stderr, stdout, succeed, write};
use pwrfgs::data::save;
use pwrfgs::model::file;
use pwrfgs_core::{Dataset, Pose, Real, Receiver, Sample};
use std::path::Path;
use std::process::Stdio;

const MODEL: &str = "model.safetensors";

fn kriged() -> String {
    let text = SMALL.replace("validation: 0.2", "validation: 0.3");
    text.replace("name: \"small\",", "name: \"small\", residuals: Kriged(), baselines: [Kriging()],")
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn every_command_reads_a_model_with_residuals() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), kriged());
    let table = stdout(&succeed(here, &["run", "p.ron", "--out", "r", "--threads", "2"]));
    for predictor in ["model", "Kriging"] {
        assert!(table.contains(&format!("90 % intervals of {predictor}: ")), "{table}");
    }
    let samples = String::from_utf8(bytes(&here.join("r/samples.csv"))).unwrap();
    assert!(
        samples.lines().next().unwrap().ends_with("nearest_train_m,coverage_90,width_90,ssim_bound_90"),
        "{samples}"
    );
    let model = "r/model.safetensors";
    let whole = bytes(&here.join(model));
    let saved = file::read_ensemble(&here.join(model)).unwrap();
    let residuals = saved.residuals().unwrap();
    let sentence = residuals.describe_share(pwrfgs_core::Task::Spectrum).unwrap();
    let note = format!("{sentence}; residuals are Kriged (");
    assert!(table.contains(&format!("model (b = {})", residuals.share().unwrap())), "{table}");
    assert!(table.contains(&note), "{table}");
    let predicted = succeed(here, &["predict", model, "--tx", "0.3,0.1,0.9", "--out", "predicted"]);
    assert!(stderr(&predicted).contains(&sentence), "{}", stderr(&predicted));
    predicts_intervals(here, model);
    assert!(stdout(&succeed(here, &["evaluate", model])).contains(&note));
    succeed(here, &["map", model, "--plane", "z=0.5", "--out", "map"]);
    succeed(here, &["export", model, "--npz", "m.npz"]);
    succeed(here, &["export", model, "--half", "half.safetensors"]);
    assert!(file::read_ensemble(&here.join("half.safetensors")).unwrap().residuals().is_some());
    let page = std::fs::read_to_string(here.join("r/report.html")).unwrap();
    assert!(page.contains(&note), "the page shows stored spectra and the note");
    assert!(page.contains("Prediction intervals: coverage of the test set"));
    assert!(file::read_ensemble(&here.join("half.safetensors")).unwrap().calibration().is_some());
    let two = ["predict", model, "half.safetensors", "--tx", "0,0,1", "--out", "no"];
    refuse(here, &two, 2, &["has a residual process", "give it as the only model"]);
    succeed(here, &["compress", model, "--out", "small.safetensors"]);
    assert!(file::read_ensemble(&here.join("small.safetensors")).unwrap().residuals().is_some());

    // Stopped between training and the fit: the model of the training alone is on disk.
    let plain = file::read_ensemble(&here.join(model)).unwrap().with_residuals(None);
    file::write_ensemble(&here.join(model), &plain).unwrap();
    std::fs::remove_file(here.join("r/run.json")).unwrap();
    succeed(here, &["run", "p.ron", "--out", "r", "--threads", "1", "-q"]);
    assert!(bytes(&here.join(model)) == whole, "another model after a restart with another number of threads");
    assert!(stderr(&succeed(here, &["run", "p.ron", "--out", "r"])).contains("nothing to do"));
}

/// A finished run takes residuals without training, as baselines and metrics; also if it is stopped between fit and scores.
#[test]
fn residuals_are_added_to_a_finished_run_without_training() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("with.ron"), kriged());
    write(&here.join("without.ron"), kriged().replace(" residuals: Kriged(),", ""));
    succeed(here, &["run", "with.ron", "--out", "fresh", "-q"]);
    succeed(here, &["run", "without.ron", "--out", "r", "-q"]);
    let log = bytes(&here.join("r/curve.csv"));
    let table = stdout(&succeed(here, &["run", "with.ron", "--out", "r"]));
    assert!(table.contains("residuals are Kriged"), "{table}");
    let fresh = bytes(&here.join("fresh").join(MODEL));
    assert!(bytes(&here.join("r").join(MODEL)) == fresh, "as if it had been trained with residuals");
    assert!(bytes(&here.join("r/curve.csv")) == log, "trained again");
    assert!(stderr(&succeed(here, &["run", "with.ron", "--out", "r"])).contains("nothing to do"));
    let other = "holds a run of another pipeline";
    refuse(here, &["run", "without.ron", "--out", "r"], 2, &[other, "residuals"]);
    refuse(here, &["run", "with.ron", "--set", "residuals=Kriged(stride: 1)", "--out", "r"], 2, &[other, "stride: 1"]);

    // Stopped after the fit, before the scores.
    std::fs::remove_file(here.join("r/run.json")).unwrap();
    succeed(here, &["run", "with.ron", "--out", "r", "-q"]);
    assert!(bytes(&here.join("r").join(MODEL)) == fresh);
    // Stopped before the fit: the model of the training alone is on disk.
    let plain = file::read_ensemble(&here.join("r").join(MODEL)).unwrap().with_residuals(None);
    file::write_ensemble(&here.join("r").join(MODEL), &plain).unwrap();
    std::fs::remove_file(here.join("r/run.json")).unwrap();
    succeed(here, &["run", "with.ron", "--out", "r", "-q"]);
    assert!(bytes(&here.join("r").join(MODEL)) == fresh);
}

/// The validation set has 10 transmitters, so the highest level is 10/11.
fn predicts_intervals(here: &Path, model: &str) {
    let predict = |level: &'static str, out: &'static str| {
        ["predict", model, "--tx", "0.3,0.1,0.9", "--no-png", "--interval", level, "--out", out]
    };
    let widths = [("0.5", "band"), ("0.9", "wide")].map(|(level, out)| {
        succeed(here, &predict(level, out));
        let table = std::fs::read_to_string(here.join(out).join("predictions.csv")).unwrap();
        assert!(
            table.starts_with("row,x,y,z,azimuth_deg,elevation_deg,peak,ssim_bound,training_distance_m"),
            "{table}"
        );
        let [lower, image, upper] =
            ["-lower", "", "-upper"].map(|end| array(&here.join(out).join(format!("00001{end}.npy"))));
        let is_inside =
            |((l, p), u): ((&f32, &f32), &f32)| 0.0 <= *l && *l <= p.clamp(0.0, 1.0) && *l <= *u && *u <= 1.0;
        assert!(lower.iter().zip(&image).zip(&upper).all(is_inside));
        upper.iter().zip(&lower).map(|(u, l)| u - l).sum::<f32>()
    });
    assert!(0.0 < widths[0] && widths[0] < widths[1], "{widths:?}");
    succeed(here, &[&predict("0.5", "stack")[..], &["--stacked"]].concat());
    for name in ["lower.npy", "upper.npy"] {
        assert!(here.join("stack").join(name).is_file(), "{name}");
    }
    for level in ["0", "1", "1.5", "-0.5", "NaN"] {
        refuse(here, &predict(level, "no"), 2, &["interval level is", "expected a number above 0 and below 1"]);
    }
    refuse(here, &predict("0.95", "no"), 2, &["needs 19 calibration blocks, but the model has 10", "to 0.909 or less"]);
    refuse(here, &predict("high", "no"), 2, &["--interval"]);
    assert!(!here.join("no").exists());
}

/// Numbers of a file of 32-bit floats.
fn array(path: &Path) -> Vec<f32> {
    bytes(path)[128..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

#[test]
fn run_needs_a_validation_set_and_valid_settings_for_residuals() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), kriged());
    let run = |set: &'static str| ["run", "p.ron", "--out", "r", "-q", "--set", set];
    refuse(here, &run("residuals=Kriged(stride: 0)"), 2, &["`stride` is 0"]);
    refuse(here, &run("split=Official(validation: 0.0)"), 2, &["residuals", "`validation` share"]);
    refuse(here, &run("residuals=Kriged(folds: true)"), 2, &["`folds` needs several models"]);
    assert!(!here.join("r").exists(), "refused before the training");
}

/// Each member leaves out its own fold; the members share the test set.
#[test]
fn joined_models_leave_out_one_fold_each() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), kriged().replace("Kriged()", "Kriged(folds: true)"));
    let experiment = "Experiment(name: \"folds\", join: true, base: \"p.ron\", seeds: [0, 1, 2])";
    write(&here.join("e.ron"), experiment);
    succeed(here, &["sweep", "e.ron", "--out", "s", "--jobs", "2", "-q"]);
    let joined = here.join("s/joined").join(MODEL);
    let ensemble = file::read_ensemble(&joined).unwrap();
    assert_eq!((ensemble.members().len(), ensemble.residuals().unwrap().processes().len()), (3, 1));
    let known = ensemble.residuals().unwrap().processes()[0].as_ref().unwrap().len();
    assert_eq!(ensemble.calibration().unwrap().block_count(), known, "each known transmitter is a block");
    for seed in 0..3 {
        let run = here.join(format!("s/seed={seed}"));
        let text = std::fs::read_to_string(run.join("pipeline.ron")).unwrap();
        assert!(text.contains("Fold(") && text.contains(&format!("index: {seed}")), "{text}");
        assert!(file::read_ensemble(&run.join(MODEL)).unwrap().residuals().is_none());
    }
    let sets = |run: &str| -> Vec<[String; 2]> {
        let text = std::fs::read_to_string(here.join(run).join("samples.csv")).unwrap();
        let fields = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let column = fields(text.lines().next().unwrap()).iter().position(|name| name == "split").unwrap();
        text.lines().skip(1).map(fields).map(|row| [row[0].clone(), row[column].clone()]).collect()
    };
    let held = |seed: usize| sets(&format!("s/seed={seed}")).into_iter().filter(|row| row[1] == "validation");
    let mut known: Vec<String> = (0..3).flat_map(held).map(|row| row[0].clone()).collect();
    known.sort();
    let mut expected: Vec<String> =
        sets("s/joined").into_iter().filter(|row| row[1] != "test").map(|row| row[0].clone()).collect();
    expected.sort();
    assert_eq!(known, expected);

    // The joined model is kept, or made again to the same bytes.
    let whole = bytes(&joined);
    succeed(here, &["sweep", "e.ron", "--out", "s", "-q"]);
    assert!(bytes(&joined) == whole);
    std::fs::remove_dir_all(here.join("s/joined")).unwrap();
    succeed(here, &["sweep", "e.ron", "--out", "s", "-q", "--threads", "1"]);
    assert!(bytes(&joined) == whole);
}

/// All members leave out the validation set, so the share b is that of their mean.
#[test]
fn joined_models_share_the_validation_set() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), kriged());
    write(&here.join("e.ron"), "Experiment(name: \"common\", join: true, base: \"p.ron\", seeds: [0, 1])");
    let without = ["sweep", "e.ron", "--out", "s", "-q", "--set", "split=Official(validation: 0.0)"];
    refuse(here, &without, 2, &["`validation` share", "Kriged(folds: true)"]);
    assert!(!here.join("s").exists(), "refused before the training");
    succeed(here, &["sweep", "e.ron", "--out", "s", "-q"]);
    let ensemble = file::read_ensemble(&here.join("s/joined").join(MODEL)).unwrap();
    assert_eq!(ensemble.calibration().unwrap().block_count(), 10, "a block per transmitter of the validation set");
    assert!(ensemble.residuals().unwrap().processes()[0].as_ref().unwrap().len() > 10, "all known links");
    let validation = |run: &str| {
        let text = std::fs::read_to_string(here.join(run).join("samples.csv")).unwrap();
        let row = |line: &str| line.split(",validation").next().filter(|row| row.len() < line.len()).map(str::to_owned);
        text.lines().filter_map(row).collect::<Vec<_>>()
    };
    assert!(!validation("s/seed=0").is_empty() && validation("s/seed=0") == validation("s/seed=1"));
}

/// A run that is interrupted while it trains ends in the same bytes.
#[test]
fn killed_run_with_residuals_resumes_to_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), kriged().replace("steps: 60", "steps: 400"));
    succeed(here, &["run", "p.ron", "--out", "whole", "-q"]);
    let mut child = pwrfgs(here);
    let mut child = child.args(["run", "p.ron", "--out", "r", "-q"]).stderr(Stdio::null()).spawn().unwrap();
    crate::common::wait_for_step(&mut child, &here.join("r"), 100);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(call(here, &["run", "p.ron", "--out", "r", "-q"]).status.success());
    assert!(bytes(&here.join("r").join(MODEL)) == bytes(&here.join("whole").join(MODEL)));
}

#[test]
fn update_adds_measurements_and_refuses_other_data() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let set = ["--set", "residuals=Kriged()", "--set", "split=Official(validation: 0.5)"];
    succeed(here, &[&["run", "p.ron", "--out", "r", "-q"][..], &set].concat());
    succeed(here, &["run", "p.ron", "--out", "plain", "-q"]);
    let update =
        |model: &'static str, data: &'static str, out: &'static str| ["update", model, "--data", data, "--out", out];
    let model = "r/model.safetensors";
    assert!(
        stderr(&succeed(here, &update(model, "data", "new.safetensors"))).contains("6 new spectra in new.safetensors")
    );
    let known = |name: &str| {
        let ensemble = file::read_ensemble(&here.join(name)).unwrap();
        ensemble.residuals().unwrap().processes()[0].as_ref().unwrap().len()
    };
    assert_eq!((known(model), known("new.safetensors")), (4, 10));
    let accept = ["--accept", "far-from-model"];
    let said = stderr(&succeed(here, &[&["update", "r", "-o", "final.safetensors"][..], &accept].concat()));
    assert!(said.contains("2 new spectra in final.safetensors"), "the test set: {said}");
    assert_eq!(known("final.safetensors"), 6);
    // Findings that the run accepted stay accepted.
    let pipeline = std::fs::read_to_string(here.join("r/pipeline.ron")).unwrap();
    assert!(pipeline.contains("accept: []"), "{pipeline}");
    write(&here.join("r/pipeline.ron"), pipeline.replace("accept: []", "accept: [\"far-from-model\"]"));
    succeed(here, &["update", "r", "-o", "accepted.safetensors"]);
    write(&here.join("r/pipeline.ron"), pipeline);
    refuse(here, &["update", "new.safetensors", "-o", "no"], 2, &["new.safetensors", "use the model of a run folder"]);
    succeed(here, &["predict", "new.safetensors", "--tx", "0.3,1.0,0.5", "--interval", "0.5", "--out", "predicted"]);

    refuse(here, &update(model, "data", "new.safetensors"), 2, &["new.safetensors exists"]);
    refuse(
        here,
        &update("plain/model.safetensors", "data", "no"),
        2,
        &["safetensors: the model has no residual process", "Kriged()"],
    );
    refuse(here, &update(model, "r", "no"), 2, &["no known layout of data"]);
    let pose = here.join("data/gateway_info.yml");
    let text = std::fs::read_to_string(&pose).unwrap();
    write(&pose, text.replace("position: [0.0,", "position: [0.5,"));
    refuse(here, &update(model, "data", "no"), 2, &["another pose"]);
    write(&pose, text);
    for id in 1..=6 {
        picture(&here.join(format!("data/spectrum/{id:05}.png")), 48, 24);
    }
    refuse(here, &update(model, "data", "no"), 2, &["12 x 6", "48 x 24"]);
    assert!(!here.join("no").exists());
}

/// Received powers of `count` transmitters in a hall of 10 m by 6 m at two receivers, changed.
fn hall(here: &Path, name: &str, from: usize, count: usize, change: &dyn Fn(f64) -> f64, unit: f64) {
    let receivers = [("a", [0.0, 0.0, 2.5]), ("b", [10.0, 6.0, 2.5])];
    let at = |(name, position): (&str, [f64; 3])| Receiver::new(name, Pose { position, ..Pose::IDENTITY });
    let place = |k: usize| [(k * 7 % 60) as f64 / 6.0, (k * 11 % 61) as f64 / 10.0, 1.0];
    let (mut samples, mut powers) = (Vec::new(), Vec::new());
    for k in from..from + count {
        for (receiver, (_, to)) in receivers.iter().enumerate() {
            let squares: f64 = place(k).iter().zip(to).map(|(a, b)| (a - b).powi(2)).sum();
            // Fading that no model of positions explains.
            let fading = ((k * 31 + receiver * 17) % 23) as f64 / 6.0;
            samples.push(Sample { receiver, ..Sample::new(k as u32, place(k).map(|v| unit * v)) });
            powers.push(change(-40.0 - 10.0 * squares.log10() - fading) as Real);
        }
    }
    let data = Dataset::of_links(name, receivers.map(at).to_vec(), vec![], &samples, powers.into()).unwrap();
    save(&data, &here.join(name)).unwrap();
}

#[test]
fn update_refuses_data_that_are_far_from_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here, "known", 0, 120, &|dbm| dbm, 1.0);
    let text = "Pipeline(name: \"p\", data: Nerf2Rssi(root: \"known\"), split: Random(validation: 0.4), residuals: Kriged(), \
                initializer: Grid(count: 12), readout: ReceivedPower(sky_deg: 30), deformation: Factored(depth: 1, width: 8, \
                tx_encoding: Octaves(1)), training: (steps: 4, batch: 4, densify_until: 2, prune_until: 3, prune_every: 1, \
                validate_every: 0, densify: (every: 0)), baselines: [], metrics: [PowerError()])";
    write(&here.join("p.ron"), text);
    succeed(here, &["run", "p.ron", "--out", "r", "-q"]);
    let update = ["update", "r/model.safetensors", "--out", "new.safetensors", "--data"];
    let with = |name: &'static str| [&update[..], &[name]].concat();
    for (name, change, unit) in [
        ("milliwatts", &(|dbm: f64| 10_f64.powf(dbm / 10.0)) as &dyn Fn(f64) -> f64, 1.0),
        ("strong", &|dbm| dbm + 30.0, 1.0),
        ("codes", &|dbm| if dbm < -50.0 { 100.0 } else { dbm }, 1.0),
        ("millimetres", &|dbm| dbm, 1000.0),
    ] {
        hall(here, name, 120, 60, change, unit);
        refuse(here, &with(name), 2, &["far from the model: error [dB]", "% intervals", "--accept far-from-model"]);
    }
    assert!(!here.join("new.safetensors").exists());
    hall(here, "right", 120, 60, &|dbm| dbm, 1.0);
    let message = stderr(&succeed(here, &with("right")));
    assert!(message.contains("new data against the model: error [dB]") && !message.contains("warning"), "{message}");

    std::fs::remove_file(here.join("new.safetensors")).unwrap();
    refuse(here, &[&with("strong")[..], &["--accept", "no-such"]].concat(), 2, &["far-from-model"]);
    succeed(here, &[&with("strong")[..], &["--accept", "far-from-model"]].concat());
    // Without calibration, distances are printed, and nothing is refused.
    let plain = file::read_ensemble(&here.join("r/model.safetensors")).unwrap().with_calibration(None);
    file::write_ensemble(&here.join("plain.safetensors"), &plain).unwrap();
    let update = ["update", "plain.safetensors", "--data", "strong", "--out", "other.safetensors"];
    let message = stderr(&succeed(here, &update));
    assert!(message.contains("new data against the model: error [dB]") && !message.contains("intervals"), "{message}");
}
