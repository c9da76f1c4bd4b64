//! Imports keep values; implausible input is an error with the next step.

use super::*;
use crate::Arrays;
use image::{ImageBuffer, Luma};
use pwrfgs_core::{DataSource as _, Dataset};
use std::fs;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

struct Folder(tempfile::TempDir);

impl Folder {
    /// Creates a folder with four positions.
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.write("tx.npy", &array(Number::F64, &[4, 3], (0..12).flat_map(|v| f64::from(v).to_le_bytes())));
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        fs::write(self.path(name), bytes).unwrap();
    }

    fn work(&self, spectra: &str) -> Import {
        Import {
            spectra: self.path(spectra),
            tx: Some(self.path("tx.npy")),
            receiver: Pose { position: [5.0, 0.26, 0.0], ..Pose::IDENTITY },
            elevation: Some((-90.0, 90.0).into()),
            name: "mine".into(),
            scale: None,
            colormap: None,
            simulated: false,
        }
    }

    fn import(&self, work: &Import) -> (Imported, Dataset) {
        let out = self.path("out");
        let _ = fs::remove_dir_all(&out);
        let imported = work.write(&out, &|_, _| {}).unwrap();
        (imported, Arrays { root: out, ..Arrays::default() }.load(Path::new(""), &|_, _| {}).unwrap())
    }

    /// The error message, with this folder as `DIR`; nothing is left behind.
    fn fault(&self, work: &Import) -> String {
        let before = fs::read_dir(self.0.path()).unwrap().count();
        let error = work.write(&self.path("out"), &|_, _| {}).unwrap_err();
        assert!(error.is_input(), "{error}");
        assert_eq!(fs::read_dir(self.0.path()).unwrap().count(), before);
        error.to_string().replace(&self.0.path().display().to_string(), "DIR")
    }

    /// Four images of 3 x 2 with one value changed.
    fn floats(&self, name: &str, at: usize, value: f32) -> Import {
        let values = (0..24).map(|i| if i == at { value } else { i as f32 / 24.0 });
        self.write(name, &array(Number::F32, &[4, 2, 3], values.flat_map(f32::to_le_bytes)));
        self.work(name)
    }
}

fn array(number: Number, shape: &[usize], bytes: impl IntoIterator<Item = u8>) -> Vec<u8> {
    npy_header(number, shape).into_iter().chain(bytes).collect()
}

#[test]
fn imported_numbers_keep_their_precision() {
    let folder = Folder::new();
    let thirds: Vec<f64> = (0..24).map(|v| f64::from(v) / 23.0).collect();
    let singles: Vec<u8> = thirds.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect();
    let cases: [(Number, Number, Vec<u8>, Vec<u8>); 4] = [
        (Number::U8, Number::U8, (0..24).collect(), (0..24).collect()),
        (Number::U16, Number::U16, (0..48).collect(), (0..48).collect()),
        (Number::F32, Number::F32, singles.clone(), singles.clone()),
        (Number::F64, Number::F32, thirds.iter().flat_map(|v| v.to_le_bytes()).collect(), singles),
    ];
    for (from, to, bytes, kept) in cases {
        folder.write("s.npy", &array(from, &[4, 2, 3], bytes));
        let work = Import { scale: (from == Number::U16).then_some(1.0).filter(|_| false), ..folder.work("s.npy") };
        let (imported, data) = folder.import(&work);
        assert_eq!((imported.shape, imported.number), ([4, 2, 3], to));
        assert_eq!((0..4).flat_map(|i| data.observations.raw(i).into_owned()).collect::<Vec<u8>>(), kept);
        assert_eq!((data.sample(3).id, data.sample(3).position()), (4, [9.0, 10.0, 11.0]));
        assert_eq!((data.title.as_str(), data.scene.pose().position), ("mine", [5.0, 0.26, 0.0]));
    }
    let (_, data) = folder.import(&Import { simulated: true, ..folder.work("s.npy") });
    assert!(data.is_simulated());
    folder.write("s.npy", &array(Number::U8, &[4, 2, 3], 0..24));
    let (imported, data) = folder.import(&Import { scale: Some(10.0), ..folder.work("s.npy") });
    assert_eq!(imported.range, (0.0, 10.0 * 23.0 / 255.0));
    assert_eq!(data.image(3).pixels[5] as f32, (10.0_f64 * 23.0 / 255.0) as f32);
}

#[test]
fn reads_images_of_8_and_16_bits() {
    let folder = Folder::new();
    fs::create_dir(folder.path("p")).unwrap();
    let save = |id: u32, bits: u32| {
        let path = folder.path(&format!("p/{id:05}.png"));
        match bits {
            16 => ImageBuffer::from_fn(3, 2, |x, y| Luma([(20_000 + 1000 * id + 10 * x + y) as u16])).save(path),
            _ => ImageBuffer::from_fn(3, 2, |x, y| Luma([(50 * id + 10 * x + y) as u8])).save(path),
        }
        .unwrap();
    };
    (1..=4).for_each(|id| save(id, 16));
    let (imported, data) = folder.import(&folder.work("p"));
    assert_eq!(imported.number, Number::U16);
    assert_eq!(data.image(3).pixels[5] as f32, 24_021.0 / 65_535.0);
    fs::remove_dir_all(folder.path("out")).unwrap();
    save(2, 8);
    assert!(folder.fault(&folder.work("p")).contains("DIR/p/00002.png: has another depth than 00001.png"));
    (1..=4).for_each(|id| save(id, 8));
    assert_eq!(folder.import(&folder.work("p")).1.observations.raw(3)[5], 221);
    fs::remove_dir_all(folder.path("out")).unwrap();
    save(5, 8);
    assert!(folder.fault(&folder.work("p")).contains("holds 5 images, but there are 4 transmitters"));
    fs::remove_file(folder.path("p/00002.png")).unwrap();
    assert!(folder.fault(&folder.work("p")).contains("holds no image 00002.png"));
}

#[test]
fn coloured_images_are_refused_or_inverted() {
    let folder = Folder::new();
    for (name, colours) in [("grey", false), ("jet", true)] {
        fs::create_dir(folder.path(name)).unwrap();
        for id in 1..=4u32 {
            let value = |x: u32, y: u32| (8 * x + y + id) as u8;
            // From cyan to yellow, jet is linear.
            let level = |v: u8| ((f64::from(v) / 255.0 - 0.375) / 0.265).clamp(0.0, 1.0);
            let jet = |v: u8| {
                let t = 0.375 + 0.265 * level(v);
                [(t - 0.35) / 0.31, 1.0, (0.65 - t) / 0.31].map(|c| (255.0 * c).round() as u8)
            };
            let pixel = |x, y| 96 + value(x, y) % 64;
            let path = folder.path(&format!("{name}/{id:05}.png"));
            if colours {
                image::RgbImage::from_fn(36, 9, |x, y| image::Rgb(jet(pixel(x, y)))).save(path).unwrap();
            } else {
                ImageBuffer::<Luma<u8>, _>::from_fn(36, 9, |x, y| Luma([pixel(x, y)])).save(path).unwrap();
            }
        }
    }
    let refused = folder.fault(&folder.work("jet"));
    assert!(refused.contains("DIR/jet/00001.png: has the colours of the colour map jet"), "{refused}");
    assert!(refused.contains("or give --colormap jet"), "{refused}");
    let work = Import { colormap: Some(Colormap::Jet), ..folder.work("grey") };
    assert!(folder.fault(&work).contains("is grey, not in colours of jet; remove --colormap"));
    let work = Import { colormap: Some(Colormap::Jet), ..folder.floats("a.npy", 23, 0.5) };
    assert!(folder.fault(&work).contains("has numbers, not colours; remove --colormap"));
    let grey = folder.import(&folder.work("grey")).1;
    let work = Import { colormap: Some(Colormap::Jet), ..folder.work("jet") };
    let jet = folder.import(&work).1;
    for k in 0..4 {
        let pair = (grey.observations.raw(k), jet.observations.raw(k));
        assert!(pair.0.iter().zip(pair.1.iter()).all(|(a, b)| a.abs_diff(*b) <= 1), "{pair:?}");
    }
}

#[test]
fn reads_stored_and_deflated_archives() {
    let folder = Folder::new();
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let mut archive = ZipWriter::new(File::create(folder.path("all.npz")).unwrap());
        let options = SimpleFileOptions::default().compression_method(method);
        for (name, bytes) in [
            ("spectra.npy", array(Number::U8, &[4, 2, 3], 60..84)),
            ("other.npy", array(Number::U8, &[4, 2, 3], 100..124)),
            ("tx.npy", fs::read(folder.path("tx.npy")).unwrap()),
        ] {
            archive.start_file(name, options).unwrap();
            archive.write_all(&bytes).unwrap();
        }
        archive.finish().unwrap();
        let work = Import { tx: None, ..folder.work("all.npz") };
        assert_eq!(folder.import(&work).1.observations.raw(0)[0], 60);
        assert_eq!(folder.import(&folder.work("all.npz:other")).1.observations.raw(0)[0], 100);
        fs::remove_dir_all(folder.path("out")).unwrap();
        let message = folder.fault(&folder.work("all.npz:others"));
        assert!(
            message.contains("no array `others`; did you mean `other`?") && message.contains("all.npz:NAME"),
            "{message}"
        );
    }
    let whole = fs::read(folder.path("all.npz")).unwrap();
    for end in [0, 10, whole.len() / 2, whole.len() - 5] {
        folder.write("all.npz", &whole[..end]);
        assert!(folder.fault(&folder.work("all.npz")).contains("is not a NumPy archive"), "{end}");
    }
}

#[test]
fn rejects_duplicate_array_names() {
    let folder = Folder::new();
    let mut archive = ZipWriter::new(File::create(folder.path("all.npz")).unwrap());
    for name in ["spectra.npy", "SPECTRA.npy"] {
        archive.start_file(name, SimpleFileOptions::default()).unwrap();
        archive.write_all(&array(Number::U8, &[4, 2, 3], 60..84)).unwrap();
    }
    archive.finish().unwrap();
    folder.import(&folder.work("all.npz"));
    fs::remove_dir_all(folder.path("out")).unwrap();
    let mut bytes = fs::read(folder.path("all.npz")).unwrap();
    let other = |bytes: &[u8]| bytes.windows(7).position(|name| name == b"SPECTRA");
    while let Some(at) = other(&bytes) {
        bytes[at..at + 7].copy_from_slice(b"spectra");
    }
    folder.write("all.npz", &bytes);
    assert!(folder.fault(&folder.work("all.npz")).contains("DIR/all.npz: holds two arrays of the same name"));

    let mut archive = ZipWriter::new(File::create(folder.path("all.npz")).unwrap());
    for name in ["spectra", "spectra.npy"] {
        archive.start_file(name, SimpleFileOptions::default()).unwrap();
        archive.write_all(&array(Number::U8, &[4, 2, 3], 60..84)).unwrap();
    }
    archive.finish().unwrap();
    assert!(folder.fault(&folder.work("all.npz")).contains("DIR/all.npz: holds two arrays of the same name"));
}

#[test]
fn rejects_ambiguous_import_with_advice() {
    let folder = Folder::new();
    let mut cases = Vec::new();
    let mut case = |work: Import, expected: &str| cases.push((folder.fault(&work), expected.to_owned()));
    case(folder.floats("a.npy", 7, f32::NAN), "DIR/a.npy: spectra[1, 0, 1] is NaN; a spectrum has a finite value");
    case(
        folder.floats("a.npy", 7, -43.5),
        "(spectra[1, 0, 1]) to 0.9583333134651184, as decibels are; spectra are linear",
    );
    case(folder.floats("a.npy", 7, -0.5), "save numpy.abs(s)");
    case(
        folder.floats("a.npy", 23, 255.0),
        "the largest value is 255 (spectra[3, 1, 2]) and spectra are from 0 to 1; give --scale 0.00392156862745098",
    );
    case(
        Import { scale: Some(0.5), ..folder.floats("a.npy", 23, 4.0) },
        "the largest value is 2 (spectra[3, 1, 2]) and spectra are from 0 to 1; give --scale 0.25",
    );
    case(
        Import { scale: Some(1e-46), ..folder.floats("a.npy", 23, 1.0) },
        "the largest value becomes 1e-46, below the smallest number of 32 bits, 1.1754944e-38; give --scale 1",
    );
    case(Import { scale: Some(f64::NAN), ..folder.floats("a.npy", 23, 1.0) }, "--scale NaN: give a finite number");
    let mut shaped = |shape: &[usize], bytes: usize, expected: &str| {
        folder.write("s.npy", &array(Number::U8, shape, vec![9; bytes]));
        case(folder.work("s.npy"), expected);
    };
    shaped(&[4, 36, 6], 864, "save s.transpose(0, 2, 1)");
    shaped(
        &[2, 3, 4],
        24,
        "has shape [2, 3, 4], so 2 spectra, and there are 4 transmitters; spectra are [M, H, W]; save numpy.moveaxis(s, 2, 0)",
    );
    shaped(&[3, 2, 3], 18, "so 3 spectra, and there are 4 transmitters");
    shaped(&[4, 6], 24, "has shape [4, 6]; spectra are [M, H, W]");
    shaped(&[4, 2, 3], 20, "which does not fit its 148 bytes; the file is truncated");
    shaped(&[4, 1 << 40, 1 << 40], 24, "does not fit its 152 bytes");
    folder.write("s.npy", &array(Number::U8, &[4, 2, 3], vec![0; 24]));
    case(folder.work("s.npy"), "every value is 0");
    let faint = |v: i32| (v as f32 * 1e-9).to_le_bytes();
    folder.write("s.npy", &array(Number::F32, &[4, 2, 3], (0..24).flat_map(faint)));
    case(folder.work("s.npy"), "1 stands for the strongest direction; give --scale 434782");
    assert_eq!(folder.import(&Import { scale: Some(1.0), ..folder.work("s.npy") }).0.number, Number::F32);
    fs::remove_dir_all(folder.path("out")).unwrap();
    let mut case = |work: Import, expected: &str| cases.push((folder.fault(&work), expected.to_owned()));
    case(folder.work("none.npy"), "cannot read DIR/none.npy");
    case(folder.work("none"), "DIR/none: no such file or folder; spectra are an array .npy");
    case(Import { tx: None, ..folder.work("s.npy") }, "name the transmitters with --tx");
    let turned = Pose { orientation: [0.0; 4], ..Pose::IDENTITY };
    case(Import { receiver: turned, ..folder.work("s.npy") }, "orientation of the receiver: the quaternion is zero");
    folder.write("tx.npy", &array(Number::F64, &[3, 4], vec![0; 96]));
    case(
        folder.work("s.npy"),
        "has shape [3, 4]; positions are [M, 3]: x, y and z of each transmitter in metres; save tx.T",
    );
    folder.write("tx.npy", &array(Number::F64, &[0, 3], []));
    case(folder.work("s.npy"), "holds no position");
    for (message, expected) in cases {
        assert!(message.contains(&expected), "{message}\n{expected}");
    }
}

#[test]
fn refuses_to_import_into_non_empty_folder() {
    let folder = Folder::new();
    let work = folder.floats("a.npy", 0, 0.0);
    fs::create_dir(folder.path("out")).unwrap();
    folder.write("out/thesis.tex", b"x");
    assert!(folder.fault(&work).contains("is not empty (it holds `thesis.tex`)"));
}
