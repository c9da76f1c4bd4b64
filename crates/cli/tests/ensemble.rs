//! Several models are an ensemble; a model in 16-bit numbers is the same model, nearly.
use crate::common::{SMALL, refuse, stdout, succeed, write};
use pwrfgs::model::file;
use std::path::Path;

/// Values of an NPY file in 32 bits.
fn npy(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap()
}

#[test]
fn several_models_predict_as_one_and_show_where_they_differ() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    for seed in ["0", "1"] {
        succeed(here, &["run", "p.ron", "--out", seed, "-q", "--scale", "0.05", "--set", &format!("seed={seed}")]);
    }
    let models = ["0/model.safetensors", "1/model.safetensors"];
    let predict = |which: &[&str], out: &str| {
        succeed(here, &[&["predict", "--tx", "0.3,0.1,0.9", "--out", out][..], which].concat());
        npy(&here.join(out).join("00001.npy"))
    };
    let (a, b) = (predict(&models[..1], "a"), predict(&models[1..], "b"));
    let both = predict(&models, "both");
    let spread = npy(&here.join("both/00001-spread.npy"));
    for (((a, b), both), spread) in a.iter().zip(&b).zip(&both).zip(&spread) {
        let (a, b) = (a.clamp(0.0, 1.0), b.clamp(0.0, 1.0));
        assert!((both - 0.5 * (a + b)).abs() < 1e-6 && (spread - 0.5 * (a - b).abs()).abs() < 1e-6);
    }
    assert!(spread.iter().any(|s| *s > 0.0));
    let png = image::open(here.join("both/00001-spread.png")).unwrap().into_luma8();
    assert!(png.as_raw().iter().zip(&spread).all(|(grey, s)| (f32::from(*grey) - 510.0 * s.min(0.5)).abs() <= 0.51));
    succeed(here, &[&["predict", "--tx", "0.3,0.1,0.9", "--stacked", "--out", "stack"][..], &models].concat());
    assert_eq!((npy(&here.join("stack/spectra.npy")), npy(&here.join("stack/spread.npy"))), (both, spread));

    let table = stdout(&succeed(here, &["evaluate", models[0], models[1]]));
    assert!(table.contains("ssim") && table.contains("2 models, the mean of their pictures"), "{table}");
    refuse(here, &["evaluate", models[0], models[1], "--out", "x"], 2, &["--out", "one model"]);
    succeed(
        here,
        &[
            "run",
            "p.ron",
            "--out",
            "2",
            "-q",
            "--scale",
            "0.02",
            "--set",
            "data=Teacher(samples: 30, width: 24, height: 6, gaussians: 3)",
        ],
    );
    refuse(
        here,
        &["predict", models[0], "2/model.safetensors", "--tx", "0,0,1", "--out", "no"],
        2,
        &["model 2", "pixels"],
    );
}

#[test]
fn a_model_in_sixteen_bits_is_half_as_large_and_predicts_nearly_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--scale", "0.05"]);
    succeed(here, &["export", "r/model.safetensors", "--half", "half.safetensors"]);
    let [whole, half] = ["r/model.safetensors", "half.safetensors"].map(|name| file::read(&here.join(name)).unwrap());
    assert_eq!(whole.cloud, half.cloud, "the Gaussians keep their digits");
    let network = |model: &pwrfgs::model::Model| model.weights.clone();
    assert!(network(&whole).iter().zip(network(&half)).all(|(w, h)| (w - h).abs() <= 5e-4 * w.abs() + 1e-7));
    let saved = |name: &str| std::fs::metadata(here.join(name)).unwrap().len() as usize;
    assert!(saved("half.safetensors") + 2 * whole.weights.len() <= saved("r/model.safetensors") + 64);
    let tx = [0.2, 0.1, 0.8];
    let (a, b) = (whole.predict(tx), half.predict(tx));
    assert!(a.pixels.iter().zip(&b.pixels).all(|(a, b)| (a - b).abs() < 0.01));
    refuse(here, &["export", "r/model.safetensors", "--half", "half.safetensors"], 2, &["half.safetensors exists"]);
}
