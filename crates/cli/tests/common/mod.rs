//! The program under test, small pipelines and small data.

pub(crate) mod browser;

use pwrfgs_core::testing::skipped;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::sync::OnceLock;
use std::time::Duration;

/// A pipeline of seconds: spectra of 48x12 pixels, 8 Gaussians.
pub(crate) const SMALL: &str = "Pipeline(
    name: \"small\",
    data: Teacher(gaussians: 4, samples: 40, width: 48, height: 12),
    split: Official(validation: 0.2),
    initializer: Grid(count: 8),
    deformation: Mlp(depth: 2, width: 16, skip: None),
    pruners: [LearnableMask(lambda: 0.02, learning_rate: 0.1), OpacityThreshold()],
    training: (
        steps: 60, batch: 2, densify_until: 20, prune_until: 40, prune_every: 10, validate_every: 20,
        checkpoint_every: 10, densify: (every: 5, from: 5),
    ),
)
";

/// The program, told to stand in `folder`.
pub(crate) fn pwrfgs(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pwrfgs"));
    command.current_dir(folder).env_remove("RUST_LOG");
    command
}

/// Runs it to its end.
pub(crate) fn call(folder: &Path, arguments: &[&str]) -> Output {
    pwrfgs(folder).args(arguments).output().unwrap()
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Runs it and insists on success.
pub(crate) fn succeed(folder: &Path, arguments: &[&str]) -> Output {
    let output = call(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

/// Runs it and insists on exit code `code` and one message that holds all of `words`.
pub(crate) fn refuse(folder: &Path, arguments: &[&str], code: i32, words: &[&str]) {
    let output = call(folder, arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    assert_eq!(message.matches("error: ").count(), 1, "{arguments:?}: {message}");
    assert!(!message.contains("panicked"), "{message}");
    for word in words {
        assert!(message.contains(word), "{arguments:?}: `{word}` is not in: {message}");
    }
}

/// A folder with `SMALL` in `p.ron` and its finished run with checkpoint in `run`, trained once for all tests, which change nothing in it.
pub(crate) fn small_run() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("small-run");
        _ = std::fs::remove_dir_all(&folder);
        write(&folder.join("p.ron"), SMALL);
        succeed(&folder, &["run", "p.ron", "--out", "run", "-q", "--keep-checkpoint"]);
        folder
    })
}

/// `SMALL` in `p.ron`, and a copy of its finished run in `out`.
pub(crate) fn copy_small_run(here: &Path, out: &str) {
    let whole = small_run();
    write(&here.join("p.ron"), SMALL);
    std::fs::create_dir_all(here.join(out)).unwrap();
    for entry in std::fs::read_dir(whole.join("run")).unwrap().map(Result::unwrap) {
        std::fs::copy(entry.path(), here.join(out).join(entry.file_name())).unwrap();
    }
}

/// Waits until the curve of a run that `child` is at work on has the row of `step`.
pub(crate) fn wait_for_step(child: &mut Child, run: &Path, step: u64) {
    let reached = || {
        let text = std::fs::read_to_string(run.join("curve.csv")).unwrap_or_default();
        let last = text.lines().last().and_then(|line| line.split(',').next()?.parse::<u64>().ok());
        last.is_some_and(|last| last >= step)
    };
    while !reached() {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended before step {step}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Sends a signal such as `-INT`. A child that was sent `-STOP` cannot end before a test has done what it does meanwhile.
pub(crate) fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

/// Writes a file, with the folders above it.
pub(crate) fn write(path: &Path, content: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, content).unwrap();
}

/// Shape and values of an NPY file in 32 bits.
pub(crate) fn npy(path: &Path) -> (Vec<usize>, Vec<f32>) {
    let (shape, values) = pwrfgs_core::testing::npy(&std::fs::read(path).unwrap());
    (shape, values.into_iter().map(|v| v as f32).collect())
}

/// Every file below a folder, with its bytes.
pub(crate) fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            all.extend(files(&path));
        } else {
            all.insert(path.clone(), std::fs::read(path).unwrap());
        }
    }
    all
}

/// A grey picture.
pub(crate) fn picture(path: &Path, width: u32, height: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::GrayImage::from_fn(width, height, |x, y| image::Luma([(7 * x + 11 * y) as u8])).save(path).unwrap();
}

/// Six measured spectra of 12x6 pixels, a full sphere, in the NeRF2 layout, and a pipeline beside them.
pub(crate) fn measured(folder: &Path) {
    let root = folder.join("data");
    for id in 1..=6 {
        picture(&root.join(format!("spectrum/{id:05}.png")), 12, 6);
    }
    let rows = [1, 2, 3, 4, 5, 6].map(|i| format!("0.{i},1.0,0.5\n")).concat();
    write(&root.join("tx_pos.csv"), format!("x,y,z\n{rows}"));
    write(
        &root.join("gateway_info.yml"),
        "gateway1:\n  position: [0.0, 0.0, 0.0]\n  orientation: [0.0, 0.0, 0.0, 1.0]\nelevation: [-90, 90]\n",
    );
    write(&root.join("train_index.txt"), "00001\n00002\n00003\n00004\n");
    write(&root.join("test_index.txt"), "00005\n00006\n");
    let text = SMALL
        .replace("Teacher(gaussians: 4, samples: 40, width: 48, height: 12)", "Nerf2Spectrum(root: \"data\")")
        .replace("validation: 0.2", "validation: 0")
        .replace("steps: 60", "steps: 60, scale: 0.05");
    write(&folder.join("p.ron"), text);
}

/// A Python with `NumPy`. Where there is none, the test is skipped and says so; where `CI` is set, it fails.
pub(crate) fn python(otherwise: &str) -> Option<&'static str> {
    let works =
        |python: &&str| Command::new(python).args(["-c", "import numpy"]).output().is_ok_and(|o| o.status.success());
    let found = ["python3", "/usr/bin/python3"].into_iter().find(works);
    if found.is_none() {
        assert!(std::env::var_os("CI").is_none(), "no python3 with NumPy; install python3-numpy");
        skipped(&format!("no python3 with NumPy, so {otherwise}"));
    }
    found
}
