//! `--device`: messages of programs with and without GPU support; a training on a GPU, a software one if there is no other.

use crate::common::{refuse, succeed};
use std::path::Path;

#[test]
fn unknown_devices_are_refused() {
    let here = Path::new(".");
    refuse(
        here,
        &["pipelines", "--device", "gpu0"],
        2,
        &["expected cpu, gpu, auto, or a number from `pwrfgs devices`"],
    );
    let output = crate::common::pwrfgs(here).arg("pipelines").env("PWRFGS_DEVICE", "cuda").output().unwrap();
    let message = crate::common::stderr(&output);
    assert!(message.contains("PWRFGS_DEVICE is `cuda`: expected cpu, gpu, auto"), "{message}");
    assert_eq!(output.status.code(), Some(2));
    succeed(here, &["pipelines", "--device", "cpu"]);
    succeed(here, &["pipelines", "--device", "auto"]);
}

#[test]
#[cfg(not(feature = "gpu"))]
fn program_without_gpu_support_says_how_to_get_it() {
    let here = Path::new(".");
    let words =
        ["this program was compiled without GPU support; compile it with `cargo build --release --features gpu`"];
    refuse(here, &["pipelines", "--device", "gpu"], 2, &[words[0], "--device gpu: "]);
    refuse(here, &["pipelines", "--device", "0"], 2, &words);
    refuse(here, &["devices"], 2, &words);
}

#[cfg(feature = "gpu")]
mod with_gpu {
    use super::*;
    use crate::common::{SMALL, call, pwrfgs, stderr, stdout, wait_for_step, write};
    use crate::resume::curve;
    use pwrfgs_core::testing::skipped;
    use regex::Regex;
    use std::process::{Command, Output, Stdio};

    /// The program with a GPU of any kind.
    fn on_gpu(folder: &Path) -> Command {
        let mut command = pwrfgs(folder);
        command.env("PWRFGS_DEVICE_SOFTWARE", "1").env("PWRFGS_DEVICE", "gpu").env("XDG_RUNTIME_DIR", folder);
        command
    }

    fn run(folder: &Path, arguments: &[&str]) -> Output {
        on_gpu(folder).args(arguments).output().unwrap()
    }

    /// Whether the machine has a GPU; reports a skipped test without one.
    fn has_gpu() -> bool {
        let listed = stdout(&succeed(Path::new("."), &["devices"]));
        let found = !listed.starts_with("no GPU found");
        if !found {
            skipped("no GPU here, nor Debian's mesa-vulkan-drivers and libvulkan1");
        }
        found
    }

    /// `SMALL`, in which Gaussians appear and vanish, with a row of the curve per step. The Gaussians of a grid are equally far
    /// from the receiver, so that rounding would decide their order.
    fn busy() -> String {
        let scattered = SMALL.replace("Grid(count: 8)", "Random(count: 8, std: 3)");
        scattered.replace("lambda: 0.02, learning_rate: 0.1", "lambda: 0.5, learning_rate: 0.3")
    }

    /// A method without Gaussians.
    const NERF2: &str = "Pipeline(
    name: \"nerf2\",
    data: Teacher(gaussians: 4, samples: 40, width: 48, height: 12),
    split: Official(validation: 0.2),
    method: Nerf2(depth: 2, width: 16, samples: 6),
    training: (
        steps: 60, batch: 2, densify_until: 0, prune_until: 0, rays: Same(100), validate_every: 20, checkpoint_every: 10,
        loss: (ssim_weight: 0, pixel: Squared),
    ),
)
";

    /// Compares the numbers of Gaussians and the losses of thirty steps.
    fn compare_curves(here: &Path, cpu: &str, gpu: &str) {
        let [expected, found] = [cpu, gpu].map(|name| curve(&here.join(name)));
        assert_eq!(expected.len(), found.len());
        for (expected, found) in expected.iter().zip(&found).skip(1).take(30) {
            let [expected, found]: [Vec<&str>; 2] = [expected, found].map(|row| row.split(',').collect());
            assert_eq!((expected[0], expected[4]), (found[0], found[4]), "steps and numbers of Gaussians");
            let [a, b] = [expected[2], found[2]].map(|loss| loss.parse::<f64>().unwrap());
            assert!((a - b).abs() <= 1e-4, "step {}: loss {a} on the CPU, {b} on the GPU", expected[0]);
        }
    }

    /// Every kind of edit within thirty steps, as in `tests/determinism.rs`.
    const EDITS: &str = "Pipeline(
        name: \"busy\", seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 90, height: 24),
        initializer: Random(count: 60, std: 3),
        deformation: Mlp(depth: 3, width: 16, skip: Some(0), tx_hidden: 8, tx_features: 4),
        pruners: [LearnableMask(lambda: 0.1, learning_rate: 0.6), OpacityThreshold(epsilon: 0.02)],
        training: (
            steps: 30, batch: 3, target_count: 70, tx_jitter_m: 0.02, densify_until: 15, prune_until: 25, prune_every: 4,
            densify: (
                from: 2, every: 4, gradient_threshold: 0, clone_below: 0.2, large_above: 0.6, large_after: 8,
                reset_every: 9, reset_opacity: 0.05,
            ),
        ),
    )";

    #[test]
    fn every_kind_of_edit_matches_the_cpu() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        // Without masks, all steps keep the parameters on the GPU.
        let bare =
            EDITS.replace("LearnableMask(lambda: 0.1, learning_rate: 0.6), ", "").replace("target_count: 70, ", "");
        let bare = bare.replace("gradient_threshold: 0,", "gradient_threshold: 0.00002,");
        for (name, text) in [("masks", EDITS), ("bare", &bare)] {
            write(&here.join("p.ron"), text);
            let [cpu, gpu] = ["cpu", "gpu"].map(|device| format!("{device}-{name}"));
            succeed(here, &["run", "p.ron", "--out", &cpu, "-q"]);
            let output = run(here, &["run", "p.ron", "--out", &gpu, "-q"]);
            assert!(output.status.success(), "{}", stderr(&output));
            compare_curves(here, &cpu, &gpu);
        }
    }

    #[test]
    fn software_gpus_are_refused() {
        let listed = stdout(&succeed(Path::new("."), &["devices"]));
        let hardware = |line: &&str| !line.trim().is_empty() && !line.contains("a software GPU");
        if listed.lines().any(|line| hardware(&line)) {
            return skipped("this machine has a GPU, or no adapter at all");
        }
        // With a folder for Mesa, which complains otherwise.
        let here = Path::new(".");
        let arguments = ["pipelines", "--device", "gpu"];
        let mut command = pwrfgs(here);
        command.env("XDG_RUNTIME_DIR", std::env::temp_dir()).env_remove("PWRFGS_DEVICE_SOFTWARE");
        let output = command.args(arguments).output().unwrap();
        let (message, whole) =
            (stderr(&output), "error: --device gpu: only .*, a software GPU slower than the CPU, was found\n");
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(Regex::new(&format!("^{whole}$")).unwrap().is_match(&message), "{message}");
        let output = call(Path::new("."), &["pipelines", "--device", "auto"]);
        assert!(output.status.success());
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn missing_gpu_is_explained() {
        // Without drivers, as in a container.
        let run = |arguments: &[&str]| {
            let mut command = on_gpu(Path::new("."));
            ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().for_each(|name| _ = command.env(name, "/dev/null"));
            command.args(arguments).output().unwrap()
        };
        let advice = "install a driver, on a cluster set VK_DRIVER_FILES";
        let output = run(&["pipelines", "--device", "gpu"]);
        let whole =
            format!("error: --device gpu: no GPU found (Vulkan, Metal, DX12); {advice}, or leave --device out\n");
        assert_eq!((output.status.code(), stderr(&output)), (Some(2), whole));
        let listed = stdout(&run(&["devices", "--device", "cpu"]));
        assert_eq!(listed, format!("no GPU found (Vulkan, Metal, DX12); {advice}\n"));
        assert!(run(&["pipelines", "--device", "auto"]).status.success());
    }

    #[test]
    fn training_on_the_gpu_matches_the_cpu_and_resumes_to_the_same_bytes() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        // The geometry of each transmitter, and one for a batch. Gaussians that stay round have no derivative by rotation, but
        // rounding has one, and Adam makes whole steps of it; so rotations do not learn with `Factored`.
        let (wrfgs, factored) = ("Wrfgs(depth: 2, width: 16, skip: None, gain: 50)", "Factored(depth: 2, width: 16)");
        let network = |name: &str| busy().replace("Mlp(depth: 2, width: 16, skip: None)", name);
        let factored = network(factored).replace("steps: 60", "optimizer: (quats: Constant(0)), steps: 60");
        let bare = busy().replace("LearnableMask(lambda: 0.5, learning_rate: 0.3), ", "");
        let cases = [
            ("Mlp", busy()),
            ("Mlp-bare", bare),
            ("Wrfgs", network(wrfgs)),
            ("Factored", factored),
            ("Nerf2", NERF2.to_owned()),
        ];
        for (network, text) in cases {
            let [cpu, gpu, killed] = ["cpu", "gpu", "killed"].map(|name| format!("{name}-{network}"));
            write(&here.join("p.ron"), text);
            succeed(here, &["run", "p.ron", "--out", &cpu, "-q"]);
            let output = run(here, &["run", "p.ron", "--out", &gpu, "-q"]);
            assert!(output.status.success(), "{}", stderr(&output));
            let gains_little =
                stderr(&output).contains("N = 8: a step on a GPU is probably not faster than on the CPU");
            assert_eq!(gains_little, network != "Nerf2", "{}", stderr(&output));
            compare_curves(here, &cpu, &gpu);

            let facts = |name: &str| std::fs::read_to_string(here.join(name).join("run.json")).unwrap();
            assert!(facts(&gpu).contains("\"device\": \"") && !facts(&cpu).contains("\"device\""));

            let arguments = ["run", "p.ron", "--out", &killed, "-q"];
            let mut child = on_gpu(here).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            wait_for_step(&mut child, &here.join(&killed), 15);
            child.kill().unwrap();
            assert!(!child.wait().unwrap().success());
            // The CPU rounds differently, so it does not take over.
            refuse(here, &arguments, 2, &["this run was trained on ", "; resume there, or start again"]);
            if network == "Mlp" {
                let arguments = ["run", "p.ron", "--out", "killed-on-cpu", "-q"];
                let mut child =
                    pwrfgs(here).args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
                wait_for_step(&mut child, &here.join("killed-on-cpu"), 15);
                child.kill().unwrap();
                child.wait().unwrap();
                let message = stderr(&run(here, &arguments));
                let whole = "this run was trained on the CPU; resume there, or start again";
                assert!(message.contains(whole), "{message}");
            }
            assert!(run(here, &arguments).status.success());
            let model = |name: &str| std::fs::read(here.join(name).join("model.safetensors")).unwrap();
            assert!(
                model(&killed) == model(&gpu) && curve(&here.join(&killed)) == curve(&here.join(&gpu)),
                "{network}"
            );
            // A finished model predicts on any device.
            succeed(here, &["predict", &gpu, "--tx", "0.5,0.5,0.5", "--out", &format!("predicted-{gpu}"), "-q"]);
        }
    }

    #[test]
    fn gpu_without_effect_is_named() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let text = SMALL
            .replace("Mlp(depth: 2, width: 16, skip: None)", "Factored(depth: 2, width: 16), calibration: AsReleased");
        write(&folder.path().join("p.ron"), text);
        let message = stderr(&run(folder.path(), &["run", "p.ron", "--out", "r", "-q"]));
        assert!(message.contains("no part of this pipeline runs on "), "{message}");
        let parts = "; only drawing with `Mercator` and `AlphaBlending`, and the networks `Mlp`, `Wrfgs` and that of `Nerf2` do";
        assert!(message.contains(parts), "{message}");
        let message = stderr(&run(folder.path(), &["check", "p.ron"]));
        assert!(message.contains("no part of this pipeline runs on "), "{message}");
        let predict = ["predict", "r", "--tx", "0.5,0.5,0.5", "--out", "predicted"];
        let message = stderr(&run(folder.path(), &predict));
        assert!(
            message.contains("note: the CPU predicts, not ")
                && message.contains(": the network of this model does not run on a GPU")
        );
    }

    #[test]
    fn part_without_kernels_is_named() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let network = "Mlp(depth: 2, width: 16, skip: None)";
        let text = SMALL.replace(network, &format!("{network}, calibration: AsReleased"));
        write(&folder.path().join("p.ron"), text);
        let output = run(folder.path(), &["run", "p.ron", "--out", "r", "-q"]);
        let message = stderr(&output);
        assert!(output.status.success(), "{message}");
        let named = "calibration AsReleased runs on the CPU; the network runs on ";
        assert_eq!(message.matches(named).count(), 1, "{message}");
    }

    #[test]
    fn predictions_use_the_gpu_where_it_wins() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let large = SMALL
            .replace("Mlp(depth: 2, width: 16,", "Mlp(depth: 1, width: 4, tx_hidden: 2, tx_features: 2,")
            .replace("Grid(count: 8)", "Grid(count: 1728)");
        for (name, text) in [("small", SMALL.to_owned()), ("large", large)] {
            write(&here.join("p.ron"), text);
            succeed(here, &["run", "p.ron", "--out", name, "-q", "--set", "training.steps=1", "--set", "pruners=[]"]);
        }
        let note = |arguments: &[&str]| -> String {
            let message = stderr(&run(here, arguments));
            message.lines().find(|line| line.starts_with("note: the CPU predicts, not ")).unwrap_or_default().to_owned()
        };
        // Few Gaussians; many, but few transmitters; many of both.
        let one = ["--tx", "0.5,0.5,0.5"];
        let walk: Vec<String> = (0..200).map(|k| format!("0.5,{},0.5", f64::from(k) / 200.0)).collect();
        write(&here.join("walk.csv"), format!("x,y,z\n{}\n", walk.join("\n")));
        let predict = |model: &'static str, tx: [&'static str; 2], out: &'static str| {
            ["predict", model, tx[0], tx[1], "--no-png", "--stacked", "--out", out]
        };
        let few = note(&predict("small", one, "a"));
        assert!(few.ends_with(": N = 8, and a GPU helps from about 1,000"), "{few}");
        let short = note(&predict("large", one, "b"));
        assert!(short.ends_with(": 1 position, and a GPU helps from about 145"), "{short}");
        assert_eq!(note(&predict("large", ["--tx-csv", "walk.csv"], "c")), "");
        succeed(here, &predict("large", ["--tx-csv", "walk.csv"], "d"));
        let numbers = |out: &str| -> Vec<f32> {
            let bytes = std::fs::read(here.join(out).join("spectra.npy")).unwrap();
            pwrfgs_core::testing::npy(&bytes).1.into_iter().map(|x| x as f32).collect()
        };
        let (gpu, cpu) = (numbers("c"), numbers("d"));
        // A Gaussian may cross the least opacity that is blended at a pixel, 1/255.
        let is_far = |(a, b): &(&f32, &f32)| (*a - *b).abs() > 1e-4;
        assert!(gpu.len() == cpu.len() && gpu.iter().zip(&cpu).filter(is_far).count() <= 3, "of 115,200 pixels");
        assert!(note(&["evaluate", "small"]).contains("N = 8"), "evaluate");
        assert!(note(&["map", "small", "--plane", "z=0.5", "--out", "m"]).contains("N = 8"), "map");
    }

    #[test]
    fn check_times_a_step_on_the_gpu() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("p.ron"), SMALL);
        let output = run(folder.path(), &["check", "p.ron"]);
        let table = stdout(&output);
        assert!(table.contains("device") && table.contains("network on "), "{table}");
        assert!(stderr(&output).contains("N = 8: a step on a GPU is probably not faster than on the CPU"));
        assert!(!stdout(&succeed(folder.path(), &["check", "p.ron"])).contains("network on "));
    }

    #[test]
    fn memory_that_runs_out_within_a_step_ends_the_run() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("p.ron"), SMALL.replace("Mlp(depth: 2, width: 16,", "Mlp(depth: 2, width: 512,"));
        let limited = |megabytes: &str| {
            let mut command = on_gpu(folder.path());
            command.args(["run", "p.ron", "--out", "r", "-q"]).env("PWRFGS_DEVICE_MEMORY", megabytes);
            command.output().unwrap()
        };
        // What the buffers of a step need, in whole megabytes; the derivative that is read back has more than one.
        let message = stderr(&limited("1"));
        let needed = Regex::new("a step needs ([0-9]+) MB").unwrap().captures(&message).expect(&message)[1].to_owned();
        let output = limited(&needed);
        let message = stderr(&output);
        let whole = format!(": out of memory, of which it has {needed} MB");
        assert!(message.contains("error: --device: ") && message.contains(&whole), "{message}");
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(!folder.path().join("r/model.safetensors").exists(), "no other device takes over");
    }

    #[test]
    fn too_little_memory_is_refused_before_the_step() {
        if !has_gpu() {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("p.ron"), SMALL.replace("Mlp(depth: 2, width: 16,", "Mlp(depth: 2, width: 512,"));
        let output = on_gpu(folder.path())
            .args(["run", "p.ron", "--out", "r", "-q"])
            .env("PWRFGS_DEVICE_MEMORY", "2")
            .output()
            .unwrap();
        let message = stderr(&output);
        for words in ["error: --device: a step needs ", " MB of GPU memory, and ", " has 2 MB; use a smaller `width`"] {
            assert!(message.contains(words), "{message}");
        }
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(!folder.path().join("r/model.safetensors").exists());
    }
}
