//! Invalid input: exit code 2, one message with file and problem, and no files written.
use crate::common::{SMALL, measured, picture, pwrfgs, refuse, stderr, stdout, succeed, write};
use std::fs;
use std::path::{Path, PathBuf};

/// A folder with good data, spoilt by `spoil`; the run must refuse it with `words` and make no run folder.
fn spoilt(words: &[&str], spoil: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    measured(folder.path());
    spoil(folder.path());
    refuse(folder.path(), &["run", "p.ron", "--out", "r"], 2, words);
    assert!(!folder.path().join("r").exists(), "{words:?}: something was written");
}

fn third_picture(here: &Path) -> PathBuf {
    here.join("data/spectrum/00003.png")
}

#[test]
fn reports_missing_and_unreadable_files() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    refuse(here, &["run", "nowhere.ron"], 2, &["cannot read nowhere.ron"]);
    refuse(here, &["run", "."], 2, &[".: not a run folder: no pipeline.ron"]);
    refuse(here, &["predict", "no.safetensors", "--tx", "0,0,0", "--out", "o"], 2, &["cannot read no.safetensors"]);
    refuse(here, &["evaluate", "no.safetensors"], 2, &["cannot read no.safetensors"]);
    write(&here.join("text.safetensors"), "no model");
    refuse(here, &["predict", "text.safetensors", "--tx", "0,0,0", "--out", "o"], 2, &["text.safetensors"]);
    write(&here.join("bytes.ron"), b"Pipeline(\n  name: \"\xff\xfe\"");
    refuse(here, &["run", "bytes.ron"], 2, &["bytes.ron:2:1", "UTF-8"]);
    assert!(!here.join("o").exists() && !here.join("runs").exists());
    for name in ["tx_pos.csv", "gateway_info.yml"] {
        spoilt(&[name], |h| std::fs::remove_file(h.join("data").join(name)).unwrap());
    }
    spoilt(&["data"], |h| std::fs::remove_dir_all(h.join("data")).unwrap());
}

#[test]
fn reports_unreadable_and_mismatched_images() {
    let name = "00003.png";
    spoilt(&[name, "13 x 6"], |h| picture(&third_picture(h), 13, 6));
    spoilt(&[name], |h| write(&third_picture(h), "not a picture"));
    spoilt(&[name], |h| write(&third_picture(h), ""));
    spoilt(&[name], |h| {
        let bytes = std::fs::read(third_picture(h)).unwrap();
        write(&third_picture(h), &bytes[..bytes.len() / 2]);
    });
    spoilt(&[name, "16"], |h| image::ImageBuffer::<image::Luma<u16>, _>::new(12, 6).save(third_picture(h)).unwrap());
    spoilt(&[name], |h| image::RgbImage::new(12, 6).save(third_picture(h)).unwrap());
}

#[test]
fn rejects_jpeg_that_is_cut_short() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::create_dir_all(here.join("c/sparse/0")).unwrap();
    fs::create_dir(here.join("c/images")).unwrap();
    write(&here.join("c/sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 64 48 40 32 24\n");
    let line = |id: u32| format!("{id} 1 0 0 0 0 0 {id} 1 {id}.jpg\n\n");
    write(&here.join("c/sparse/0/images.txt"), (1..=2).map(line).collect::<String>());
    let noisy = |x: u32, y: u32| image::Luma([(x * y * 37 % 251) as u8]);
    let whole = |id: u32| {
        let path = here.join(format!("c/images/{id}.jpg"));
        image::GrayImage::from_fn(64, 48, noisy).save(&path).unwrap();
        fs::read(path).unwrap()
    };
    let (_, bytes) = (whole(1), whole(2));
    let path = here.join("c/images/2.jpg");
    // A camera may write more after the end, and an image with an end of its own into the metadata.
    let comment = b"\xff\xfe\x00\x06\xff\xd9\xff\xd9";
    for whole in [bytes.clone(), [&bytes, &b"more"[..]].concat(), [&bytes[..2], comment, &bytes[2..]].concat()] {
        write(&path, whole);
        assert!(stdout(&succeed(here, &["inspect", "c"])).contains("2 spectra"));
    }
    let with_comment = [&bytes[..2], comment, &bytes[2..]].concat();
    for cut in [&bytes[..bytes.len() / 5], &bytes[..bytes.len() - 1], &with_comment[..with_comment.len() / 2]] {
        write(&path, cut);
        refuse(here, &["inspect", "c"], 2, &["c/images/2.jpg: is cut short", "copy it again"]);
    }
}

#[test]
fn reports_line_and_column_of_invalid_tables() {
    let table = |text: &str| {
        let text = text.to_owned();
        move |h: &Path| write(&h.join("data/tx_pos.csv"), text)
    };
    let rows = |third: &str| format!("x,y,z\n0.1,1,0.5\n0.2,1,0.5\n{third}\n0.4,1,0.5\n0.5,1,0.5\n0.6,1,0.5\n");
    spoilt(&["tx_pos.csv", "z"], table("x,y\n0.1,1\n0.2,1\n0.3,1\n0.4,1\n0.5,1\n0.6,1\n"));
    spoilt(&["tx_pos.csv:4"], table(&rows("0.3,1")));
    spoilt(&["tx_pos.csv:4"], table(&rows("0.3,NaN,0.5")));
    spoilt(&["tx_pos.csv:4"], table(&rows("0.3,1,inf")));
    spoilt(&["tx_pos.csv:4"], table(&rows("0.3,one,0.5")));
}

#[test]
fn reports_ids_without_row_or_image() {
    spoilt(&["index.txt", "9"], |h| write(&h.join("data/train_index.txt"), "00001\n00009\n"));
    spoilt(&["00002"], |h| std::fs::remove_file(h.join("data/spectrum/00002.png")).unwrap());
    spoilt(&["index.txt"], |h| write(&h.join("data/test_index.txt"), "00005\nsix\n"));
}

#[test]
fn rejects_quaternion_without_unit_length() {
    for wrong in ["[0.0, 0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 1.01]", "[0.0, 0.0, .nan, 1.0]", "[0.0, 0.0, 1.0]"] {
        spoilt(&["gateway_info.yml"], |h| {
            let text = format!("gateway1:\n  position: [0.0, 0.0, 0.0]\n  orientation: {wrong}\n");
            write(&h.join("data/gateway_info.yml"), text);
        });
    }
}

#[test]
fn rejects_empty_training_or_test_set() {
    spoilt(&["test"], |h| write(&h.join("data/test_index.txt"), ""));
    spoilt(&["train"], |h| write(&h.join("data/train_index.txt"), "\n"));
}

#[test]
fn rejects_truncated_or_damaged_point_cloud() {
    let cloud = |name: &'static str, content: &[u8]| {
        let content = content.to_owned();
        spoilt(&[name], move |h| {
            write(&h.join(name), content);
            let text = std::fs::read_to_string(h.join("p.ron")).unwrap();
            let text = text.replace("root: \"data\"", &format!("root: \"data\", points: \"{name}\""));
            write(&h.join("p.ron"), text.replace("Grid(count: 8)", "PointCloud()"));
        });
    };
    let header = |n: usize, format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        )
    };
    cloud("truncated.ply", (header(3, "ascii") + "0 0 1\n0 1 1\n").as_bytes());
    let binary = [header(3, "binary_little_endian").as_bytes(), &[0; 17]].concat();
    cloud("binary.ply", &binary);
    cloud("empty.ply", header(0, "ascii").as_bytes());
    cloud("nan.ply", (header(2, "ascii") + "0 0 1\n0 nan 1\n").as_bytes());
    cloud("no.ply", b"hello");
    cloud("nan.xyz", b"0 0 1\n0 inf 1\n");
    spoilt(&["missing.ply"], |h| {
        let text = std::fs::read_to_string(h.join("p.ron")).unwrap();
        write(&h.join("p.ron"), text.replace("root: \"data\"", "root: \"data\", points: \"missing.ply\""));
    });
    spoilt(&["point cloud"], |h| {
        let text = std::fs::read_to_string(h.join("p.ron")).unwrap();
        write(&h.join("p.ron"), text.replace("Grid(count: 8)", "PointCloud()"));
    });
}

#[test]
fn reports_position_of_pipeline_errors() {
    let mistakes: &[(&str, &str, &[&str])] = &[
        ("Grid(count: 8),", "Grid(count: 8", &["p.ron:"]),
        ("name: \"small\",", "name: \"small\" data", &["p.ron:2:"]),
        ("lambda: 0.02", "lamda: 0.02", &["p.ron:7:", "`lamda`", "did you mean `lambda`?"]),
        ("LearnableMask(", "LearnedMask(", &["p.ron:7:", "`LearnedMask`", "did you mean `LearnableMask`?"]),
        ("split:", "spilt:", &["p.ron:4:", "`spilt`", "did you mean `split`?"]),
        ("lambda: 0.02", "lambda: -0.02", &["p.ron:7:", "lambda"]),
        ("OpacityThreshold()", "LearnableMask()", &["p.ron:7:", "`LearnableMask` is listed twice; list it once"]),
        ("Grid(count: 8)", "Grid(count: 8, distance_m: 1e30)", &["p.ron:5:", "`distance_m` is 1e30", "at most 1e6"]),
        (
            "OpacityThreshold()",
            "LightGaussian(shares: [0.5])",
            &["p.ron:7:", "LightGaussian has no field `shares` (removed); set training.target_count"],
        ),
        (
            "OpacityThreshold()",
            "RandomReference()",
            &["`RandomReference` needs training.target_count, which is not set"],
        ),
        ("densify_until: 20", "densify_until: 50", &["p.ron:", "`prune_until` is below `densify_until`"]),
        ("steps: 60", "steps: 0", &["p.ron:", "`steps` is 0"]),
        ("steps: 60", "steps: -1", &["p.ron:9:"]),
        ("batch: 2", "batch: 0", &["p.ron:", "`batch` is 0"]),
        ("name: \"small\"", "name: \"../small\"", &["name"]),
        ("validation: 0.2", "validation: 1.5", &["p.ron:4:", "validation"]),
    ];
    for (good, bad, words) in mistakes {
        let folder = tempfile::tempdir().unwrap();
        assert!(SMALL.contains(good), "{good}");
        write(&folder.path().join("p.ron"), SMALL.replacen(good, bad, 1));
        refuse(folder.path(), &["run", "p.ron"], 2, words);
        assert!(!folder.path().join("runs").exists());
    }
}

#[test]
fn reports_command_line_errors() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    let set = |argument: &str, words: &[&str]| refuse(here, &["run", "p.ron", "--set", argument], 2, words);
    set("training.steps", &["--set training.steps", "path.to.field=value"]);
    set("training.step=5", &["--set training.step=5", "did you mean `steps`?"]);
    set("training.steps=0", &["`steps` is 0"]);
    set("training.scale=-1.0", &["`scale` must be positive"]);
    set("training.batch=0", &["`batch` is 0"]);
    set("deformation=Mlp(depth: 256, width: 8192)", &["the network needs about", "GB are left here"]);
    // A training that ends before its pruners are done would be scored unpruned.
    set("training.steps=30", &["ends after step 30", "until step 40", "--scale"]);
    set("method=Splatting()", &["method: `Splatting` is what the fields projector, rasterizer,", "leave `method` out"]);
    refuse(
        here,
        &["inspect", "."],
        2,
        &["neither data (spectra, received powers or channels) nor a run found; name a data"],
    );
    set("split=Offical", &["--set split=Offical", "did you mean `Official`?"]);
    set("data=Teachr()", &["did you mean `Teacher`?"]);
    set("pruners=[LearnableMask(lambda: -1.0)]", &["lambda"]);
    refuse(here, &["run", "p.ron", "--threads", "0"], 2, &["--threads"]);
    refuse(here, &["run"], 2, &["<PIPELINE>"]);
    assert!(!here.join("runs").exists());
}

#[test]
fn huge_numbers_have_an_exponent_in_messages() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    for (set, words) in [
        ("split=Voxel(size_m: -1e300)", "`size_m` is -1e300; use"),
        ("split=Random(test: 1.5e300)", "`test` is 1.5e300; it is"),
        ("data=Channels(spacing_hz: -1e300)", "`spacing_hz` is -1e300; give"),
        ("pruners=[OpacityThreshold(epsilon: 1e35)]", "`epsilon` is 1e35; give"),
        ("baselines=[RayTracing(position_error_m: 1e300)]", "`position_error_m` is 1e300; give"),
    ] {
        refuse(here, &["check", "p.ron", "--set", set], 2, &[words]);
    }
}

#[test]
fn rejects_too_many_threads_in_the_environment() {
    let called = |name: &str, value: &str, arguments: &[&str]| {
        let output = pwrfgs(Path::new(".")).args(arguments).env(name, value).output().unwrap();
        (output.status.code(), stderr(&output))
    };
    for (name, value) in [("RAYON_NUM_THREADS", "100000"), ("RAYON_NUM_THREADS", "all"), ("RAYON_RS_NUM_CPUS", "1025")]
    {
        let (code, message) = called(name, value, &["plugins", "Grid"]);
        assert_eq!(code, Some(2), "{name}={value}: {message}");
        assert!(message.contains(&format!("{name} is `{value}`; give a number from 1 to 1024")), "{message}");
        let (code, message) = called(name, value, &["plugins", "Grid", "--threads", "1"]);
        assert_eq!(code, Some(0), "--threads decides: {message}");
    }
    for value in ["", "0", "1", "1024"] {
        assert_eq!(called("RAYON_NUM_THREADS", value, &["plugins", "Grid"]).0, Some(0), "{value}");
    }
}

#[test]
fn reports_line_and_column_of_invalid_positions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--scale", "0.02", "--keep-checkpoint"]);
    let model = "r/model.safetensors";
    let csv = |text: &str, words: &[&str]| {
        write(&here.join("tx.csv"), text);
        refuse(here, &["predict", model, "--tx-csv", "tx.csv", "--out", "o"], 2, words);
    };
    csv("x,y\n1,2\n", &["tx.csv:1:1", "no column `z`"]);
    csv("1,2,3\n", &["tx.csv:1:1", "no column `x`"]);
    csv("x,y,z\n1,2,3\n1,2\n", &["tx.csv:3:4", "2 of the 3 columns"]);
    csv("x,y,z\n1,NaN,3\n", &["tx.csv:2:3", "`NaN` is not finite"]);
    csv("x,y,z\n1,2,inf\n", &["tx.csv:2:5"]);
    csv("x,y,z\n", &["tx.csv", "no row"]);
    csv("", &["tx.csv"]);
    refuse(here, &["predict", model, "--tx", "1,2", "--out", "o"], 2, &["--tx 1,2"]);
    refuse(here, &["predict", model, "--out", "o"], 2, &["--tx"]);
    let bytes = std::fs::read(here.join(model)).unwrap();
    write(&here.join("half.safetensors"), &bytes[..bytes.len() / 2]);
    refuse(here, &["predict", "half.safetensors", "--tx", "0,0,1", "--out", "o"], 2, &["half.safetensors"]);
    assert!(!here.join("o").exists());
    // A checkpoint that was cut is no reason to start again silently.
    std::fs::remove_file(here.join(model)).unwrap();
    let checkpoint = here.join("r/checkpoint.safetensors");
    let bytes = std::fs::read(&checkpoint).unwrap();
    write(&checkpoint, &bytes[..bytes.len() - 9]);
    refuse(here, &["run", "p.ron", "--out", "r", "--scale", "0.02"], 2, &["checkpoint.safetensors", "remove it"]);
}
