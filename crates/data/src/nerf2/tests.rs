//! A small folder in the NeRF2 layout, and errors of invalid content.

use super::*;
use crate::splits::Voxel;
use image::{ColorType, ExtendedColorType, ImageBuffer, Luma};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{Plugin, Split, rng};
use std::{collections::BTreeSet, fs};

const WIDTH: u32 = 8;
const HEIGHT: u32 = 3;

/// Four rows; images 1, 2 and 3; 1 and 3 are training samples, 2 is a test sample.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::create_dir_all(folder.path("s/spectrum")).unwrap();
        folder.write("s/gateway_info.yml", "gateway1:\n  position: [5.0, 0.26, 0]\n  orientation: [0, 0, 0, 1]\n");
        folder.write("s/tx_pos.csv", "x,y,z\n1,2,3\n4,5,6\n7,8,9\n1,1,1\n");
        folder.write("s/train_index.txt", "00003\n00001\n");
        folder.write("s/test_index.txt", "00002\n");
        (1..=3).for_each(|id| folder.grey(&format!("{id:05}"), WIDTH, HEIGHT, id));
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        fs::write(self.path(name), text).unwrap();
    }

    fn grey(&self, stem: &str, width: u32, height: u32, value: u8) {
        let picture = ImageBuffer::from_fn(width, height, |x, y| Luma([value + (x + 10 * y) as u8]));
        picture.save(self.path(&format!("s/spectrum/{stem}.png"))).unwrap();
    }

    fn remove(&self, name: &str) {
        fs::remove_file(self.path(name)).unwrap();
    }

    fn source() -> Nerf2Spectrum {
        Nerf2Spectrum { root: "s".into(), ..Nerf2Spectrum::default() }
    }

    fn load(&self) -> Dataset {
        Self::source().load(self.0.path(), &|_, _| {}).unwrap()
    }

    /// The error message, with the folder path as `DIR`.
    fn fault(&self) -> String {
        let error = Self::source().load(self.0.path(), &|_, _| {}).unwrap_err();
        assert!(error.is_input());
        error.to_string().replace(&self.0.path().display().to_string(), "DIR")
    }
}

#[test]
fn reads_valid_nerf2_folder() {
    let folder = Folder::new();
    let data = folder.load();
    assert_eq!(data.title, "s (measured, NeRF2 layout)");
    assert_eq!((data.width, data.height), (8, 3));
    assert_eq!(
        data.samples().map(|s| (s.id, s.position())).collect::<Vec<_>>(),
        [(1, [1.0, 2.0, 3.0]), (2, [4.0, 5.0, 6.0]), (3, [7.0, 8.0, 9.0])]
    );
    assert_eq!(data.observations.raw(1)[..3], [2, 3, 4]);
    assert_eq!(data.observations.raw(1)[8], 12);
    assert_eq!(data.official, Some((vec![0, 2], vec![1])));
    assert_eq!(data.scene.pose().position, [5.0, 0.26, 0.0]);
    assert_eq!(data.scene.bounds, ([1.0, 0.26, 0.0], [7.0, 8.0, 9.0]));
}

#[test]
fn reads_the_carrier_of_every_row() {
    let folder = Folder::new();
    folder.write("s/tx_pos.csv", "x,y,z\n1,2,3\n4,5,6\n1,2,3\n1,1,1\n");
    folder.write("s/freq.txt", "2.4\n2.4\n2.5\n2.5\n");
    let data = folder.load();
    let rows: Vec<(u32, &str)> =
        data.samples().map(|s| (s.id, data.scene.receivers[s.receiver].name.as_str())).collect();
    assert_eq!(rows, [(1, "2400MHz"), (1, "2500MHz"), (2, "2400MHz")]);
    let first: Vec<u8> = (0..3).map(|i| data.observations.raw(i)[0]).collect();
    assert_eq!((first, data.official), (vec![1, 3, 2], Some((vec![0, 1], vec![2]))));
    folder.write("s/freq.txt", "2.4\n");
    assert_eq!(folder.fault(), "DIR/s/freq.txt: has 1 lines, but tx_pos.csv has 4 rows; write one line per row");
}

#[test]
fn file_format_variants_give_same_data() {
    let folder = Folder::new();
    let plain = folder.load();
    folder.write("s/tx_pos.csv", "\u{feff}time, Z,Y ,X\r\n0,3,2,1\r\n1,6,5,4\r\n2,9,8,7\r\n3,1,1,1\r\n\r\n");
    folder.write("s/train_index.txt", "1\r\n3\r\n");
    folder.write("s/test_index.txt", "2");
    folder.write("s/spectrum/notes.txt", "not a picture");
    folder.write(
        "s/gateway_info.yml",
        "dataset_name: s\ngateway1: {position: [5, 0.26, 0.0], orientation: [0, 0, 0, 1.0]}\n",
    );
    let varied = folder.load();
    assert_eq!(
        format!("{:?}", (plain.locations, plain.observations)),
        format!("{:?}", (varied.locations, varied.observations))
    );
    assert_eq!(plain.official, varied.official);
    assert_eq!(plain.title, varied.title);
}

#[test]
fn accepts_missing_lists_and_skips_images_without_row() {
    let folder = Folder::new();
    folder.remove("s/train_index.txt");
    folder.remove("s/test_index.txt");
    folder.grey("00009", WIDTH, HEIGHT, 0);
    let data = folder.load();
    assert_eq!(data.official, None);
    assert_eq!(data.len(), 3);
    assert_eq!(data.unmatched, Unmatched { positions: 1, spectra: 1 });
}

#[test]
fn simulated_data_are_marked() {
    let folder = Folder::new();
    assert!(!folder.load().is_simulated());
    let simulation_and_title = |manifest: &str| {
        folder.write("s/manifest.json", manifest);
        let data = folder.load();
        (data.simulation.map(|simulation| simulation.scene), data.title)
    };
    let (simulated, measured) = ("s (NeRF2 layout)".to_owned(), "s (measured, NeRF2 layout)".to_owned());
    assert_eq!(
        simulation_and_title(r#"{"simulated": true, "scene": "(..)", "seed": 1}"#),
        (Some(Some("(..)".into())), simulated.clone())
    );
    assert_eq!(simulation_and_title(r#"{"simulated": true}"#), (Some(None), simulated));
    for other in [r#"{"simulated": false}"#, r#"{"name": "an app"}"#, "[]", "{"] {
        assert_eq!(simulation_and_title(other), (None, measured.clone()), "{other}");
    }
    folder.write(
        "s/gateway_info.yml",
        "dataset_name: a (Simulated)\ngateway1: {position: [5, 0, 0], orientation: [0, 0, 0, 1]}\n",
    );
    assert_eq!(simulation_and_title("{"), (Some(None), "a (Simulated) (NeRF2 layout)".into()));
    assert_eq!(simulation_and_title(r#"{"simulated": false}"#).0, None);
}

#[test]
fn rejects_image_size_that_contradicts_angles() {
    let folder = Folder::new();
    let shape = |width, height| (1..=3).for_each(|id| folder.grey(&format!("{id:05}"), width, height, 0));
    let load = |elevation: Option<(f64, f64)>| {
        let source = Nerf2Spectrum { elevation: elevation.map(Into::into), ..Folder::source() };
        let data = source.load(folder.0.path(), &|_, _| {}).map(|data| (data.elevation.first, data.elevation.last));
        data.map_err(|e| e.to_string().replace(&folder.0.path().display().to_string(), "DIR"))
    };
    shape(36, 18);
    let error = load(None).unwrap_err();
    assert_eq!(
        error,
        "DIR/s/spectrum/00001.png: is 36 x 18 pixels: over azimuths 0 to 360 and elevations 0 to 90 degrees each would be \
         10.000 x 5.000 degrees; set the elevations of the top and bottom edge, such as \
         `elevation: (-90, 90)` of the data source for a full sphere, or `elevation: [-90, 90]` in gateway_info.yml"
    );
    assert_eq!(load(Some((-90.0, 90.0))), Ok((-90.0, 90.0)));
    assert_eq!(load(Some((0.0, 90.0))), Ok((0.0, 90.0)), "who says so may have pixels that are not square");
    assert!(load(Some((0.0, 9.0))).unwrap_err().contains("elevations 0 to 9 degrees each would be 10.000 x 0.500"));
    let gateway = fs::read_to_string(folder.path("s/gateway_info.yml")).unwrap();
    folder.write("s/gateway_info.yml", format!("{gateway}elevation: [90, -90]\n"));
    assert_eq!(load(None), Ok((90.0, -90.0)));
    assert_eq!(load(Some((-90.0, 90.0))), Ok((-90.0, 90.0)), "the pipeline overrules the file");
    folder.write("s/gateway_info.yml", format!("{gateway}elevation: [0, 91]\n"));
    let error = load(None).unwrap_err();
    assert!(error.starts_with("DIR/s/gateway_info.yml:4:12: `elevation` is (0, 91); give the elevations"), "{error}");
    folder.write("s/gateway_info.yml", format!("{gateway}elevation: 90\n"));
    assert!(load(None).unwrap_err().starts_with("DIR/s/gateway_info.yml:4:"));
    folder.write("s/gateway_info.yml", gateway);
    // Usual sizes, 90 x 24, 48 x 12 and 8 x 3; a hemisphere at half the rows.
    for (width, height) in [(90, 24), (48, 12), (8, 3), (60, 24), (6, 1)] {
        shape(width, height);
        assert_eq!(load(None), Ok((0.0, 90.0)), "{width} x {height}");
    }
    for (width, height) in [(90, 12), (48, 48), (8, 4)] {
        shape(width, height);
        assert!(load(None).is_err(), "{width} x {height}");
    }
    let parse = |elevation: &str| {
        Plugin::<dyn DataSource>::parse(&format!("Nerf2Spectrum(elevation: {elevation})")).map_err(|e| e.clone())
    };
    assert!(parse("(-90, 90)").is_ok() && parse("(0, 0)").is_err() && parse("(0, 100)").is_err());
}

#[test]
fn point_cloud_extends_scene_bounds() {
    let folder = Folder::new();
    folder.write("room.xyz", "-1 0 0\n0 20 0\n");
    let source = Nerf2Spectrum { points: Some("room.xyz".into()), ..Folder::source() };
    let data = source.load(folder.0.path(), &|_, _| {}).unwrap();
    assert_eq!(data.scene.points.len(), 2);
    assert_eq!(data.scene.bounds, ([-1.0, 0.0, 0.0], [7.0, 20.0, 9.0]));
}

#[test]
fn reports_missing_file() {
    let fault_without = |name: &str| {
        let folder = Folder::new();
        folder.remove(name);
        folder.fault()
    };
    assert_eq!(
        fault_without("s/gateway_info.yml"),
        format!("cannot read DIR/s/gateway_info.yml: no such file; {LAYOUT}")
    );
    let table = "write a table with the columns x, y, z; give every row x, y and z in metres";
    assert_eq!(fault_without("s/tx_pos.csv"), format!("cannot read DIR/s/tx_pos.csv: no such file; {table}"));
    assert_eq!(
        fault_without("s/train_index.txt"),
        "DIR/s/test_index.txt: this file comes without train_index.txt; give both or neither (then use a split such as Random())"
    );
    assert_eq!(
        fault_without("s/test_index.txt"),
        "DIR/s/train_index.txt: this file comes without test_index.txt; give both or neither (then use a split such as Random())"
    );
    assert_eq!(
        fault_without("s/spectrum/00003.png"),
        "DIR/s/train_index.txt:1:1: id 3 has no image spectrum/00003.png; add the image or remove the id"
    );
    let folder = Folder::new();
    fs::rename(folder.path("s"), folder.path("t")).unwrap();
    let error = folder.fault();
    assert!(
        error.starts_with(&format!("DIR/s: no such folder ({LAYOUT}); set `root` of Nerf2Spectrum, or ")),
        "{error}"
    );
    assert!(
        error.contains("https://github.com/XPengZhao/NeRF2") && error.ends_with("docs/data.md#get-measured-data"),
        "{error}"
    );
    let folder = Folder::new();
    fs::rename(folder.path("s/spectrum"), folder.path("s/spectra")).unwrap();
    assert_eq!(folder.fault(), format!("cannot read DIR/s/spectrum: no such folder; {LAYOUT}"));
}

#[test]
fn reports_unreadable_file() {
    for name in ["gateway_info.yml", "tx_pos.csv", "train_index.txt", "spectrum/00002.png"] {
        let folder = Folder::new();
        folder.remove(&format!("s/{name}"));
        fs::create_dir(folder.path(&format!("s/{name}"))).unwrap(); // unreadable_error as a file, even for root
        let message = folder.fault();
        assert!(message.starts_with(&format!("cannot read DIR/s/{name}: ")), "{message}");
    }
}

#[test]
fn reports_line_and_column_in_tx_pos() {
    let advice = "give every row x, y and z in metres";
    let cases: [(&str, String); 9] = [
        ("", format!(": is empty; write a table with the columns x, y, z; {advice}")),
        ("x,y,z\n", ": has a header but no row; give every row x, y and z in metres".into()),
        ("x,y\n1,2\n", ":1:1: no column `z`; the first line must name the columns x, y, z".into()),
        ("1,2,3\n", ":1:1: no column `x`; the first line must name the columns x, y, z".into()),
        ("x,y,z\n1,2,3\n4,5\n", format!(":3:4: the row ends after 2 of the 3 columns that `z` needs; {advice}")),
        ("x,y,z\r\n1,nan,3\r\n", format!(":2:3: `nan` is not finite; {advice}")),
        ("x,y,z\n1,2, -inf\n", format!(":2:6: `-inf` is not finite; {advice}")),
        ("x,y,z\n1,2,three\n", format!(":2:5: `three` is not a number; {advice}")),
        ("x,y,z\n1,,3\n", format!(":2:3: `` is not a number; {advice}")),
    ];
    for (text, message) in cases {
        let folder = Folder::new();
        folder.write("s/tx_pos.csv", text);
        assert_eq!(folder.fault(), format!("DIR/s/tx_pos.csv{message}"));
    }
}

#[test]
fn reports_line_and_column_in_index_files() {
    let cases = [
        (
            "00001\n0\n",
            "train_index.txt:2:1: invalid id 0; ids count from 1, the first row of tx_pos.csv; if both index files count from 0, \
             add 1 to each number",
        ),
        ("1\n\n 5\n", "train_index.txt:3:2: id 5 has no row in tx_pos.csv, which has 4; add the row or remove the id"),
        ("4\n", "train_index.txt:1:1: id 4 has no image spectrum/00004.png; add the image or remove the id"),
        ("a.png\n", "train_index.txt:1:1: `a.png` is not a sample id; write one per line, such as 00001"),
        ("-1\n", "train_index.txt:1:1: `-1` is not a sample id; write one per line, such as 00001"),
        (
            "1\n00001\n",
            "train_index.txt:2:1: id 1 was already named in train_index.txt, line 1; a sample belongs to one set: remove one of the two",
        ),
        (
            "1\n3\n2\n",
            "test_index.txt:1:1: id 2 was already named in train_index.txt, line 3; a sample belongs to one set: remove one of the two",
        ),
        ("\r\n", "train_index.txt: names no sample; list at least one id, or remove both index files"),
    ];
    for (text, message) in cases {
        let folder = Folder::new();
        folder.write("s/train_index.txt", text);
        assert_eq!(folder.fault(), format!("DIR/s/{message}"));
    }
    let folder = Folder::new();
    folder.write("s/test_index.txt", "");
    assert_eq!(
        folder.fault(),
        "DIR/s/test_index.txt: names no sample; list at least one id, or remove both index files"
    );
}

#[test]
fn reports_invalid_images() {
    let save = |folder: &Folder, bytes: &[u8], color: ExtendedColorType| {
        image::save_buffer(folder.path("s/spectrum/00002.png"), bytes, WIDTH, HEIGHT, color).unwrap();
        folder.fault()
    };
    let pixels = (WIDTH * HEIGHT) as usize;
    let grey = "a spectrum is 8-bit grey with one channel: convert it";
    for (color, kind) in [
        (ColorType::L16, "16-bit grey"),
        (ColorType::La8, "8-bit grey with transparency"),
        (ColorType::Rgb8, "8-bit colour"),
        (ColorType::Rgba16, "16-bit colour"),
    ] {
        let message = save(&Folder::new(), &vec![0; pixels * usize::from(color.bytes_per_pixel())], color.into());
        assert_eq!(message, format!("DIR/s/spectrum/00002.png: is {kind}; {grey}"));
    }
    let folder = Folder::new();
    folder.grey("00002", HEIGHT, WIDTH, 0);
    assert_eq!(
        folder.fault(),
        "DIR/s/spectrum/00002.png: is 3 x 8 pixels, but 00001.png is 8 x 3; all images must have one size"
    );
    for text in ["GIF89a", "", "hello, I am text"] {
        let folder = Folder::new();
        folder.write("s/spectrum/00002.png", text);
        assert_eq!(folder.fault(), "DIR/s/spectrum/00002.png: is not a PNG image; save the spectrum as 8-bit grey PNG");
    }
}

#[test]
fn rejects_truncated_or_damaged_image() {
    let folder = Folder::new();
    let whole = fs::read(folder.path("s/spectrum/00002.png")).unwrap();
    let end_of_data = whole.len() - 12; // the last chunk, IEND, adds nothing
    for length in 8..end_of_data {
        folder.write("s/spectrum/00002.png", &whole[..length]);
        let message = folder.fault();
        assert!(message.starts_with("DIR/s/spectrum/00002.png: is cut short or damaged ("), "{length}: {message}");
        assert!(message.ends_with("; copy it again"), "{message}");
    }
    let mut flipped = whole;
    flipped[end_of_data - 6] ^= 0xff;
    folder.write("s/spectrum/00002.png", flipped);
    assert!(folder.fault().contains("is cut short or damaged ("));
}

#[test]
fn does_not_unpack_large_colour_profile() {
    use image::{ImageDecoder as _, ImageEncoder as _, codecs::png::PngEncoder};
    let profile_of = |bytes: usize| {
        let mut png = Vec::new();
        let mut encoder = PngEncoder::new(&mut png);
        encoder.set_icc_profile(vec![0; bytes]).unwrap();
        encoder.write_image(&[7; 24], WIDTH, HEIGHT, ExtendedColorType::L8).unwrap();
        assert!(png.len() < 1 << 20, "{} bytes hold {bytes}", png.len());
        let folder = Folder::new();
        folder.write("s/spectrum/00002.png", &png);
        assert_eq!(folder.load().observations.raw(1).as_ref(), [7; 24]);
        pictures::png_decoder(png).unwrap().icc_profile().unwrap()
    };
    assert_eq!(profile_of(100).map(|p| p.len()), Some(100));
    assert_eq!(profile_of(40 << 20), None, "forty megabytes from less than one");
}

#[test]
fn image_ids_are_unique_and_start_at_one() {
    let folder = Folder::new();
    folder.grey("2", WIDTH, HEIGHT, 0);
    assert_eq!(folder.fault(), "DIR/s/spectrum/2.png: 00002.png is id 2 as well; remove one of the two");
    let folder = Folder::new();
    folder.grey("00000", WIDTH, HEIGHT, 0);
    assert_eq!(
        folder.fault(),
        "DIR/s/spectrum/00000.png: invalid id 0; ids count from 1, so number the images from 00001"
    );
}

#[test]
fn rejects_folder_without_images() {
    let folder = Folder::new();
    (1..=3).for_each(|id| folder.remove(&format!("s/spectrum/{id:05}.png")));
    folder.remove("s/train_index.txt");
    folder.remove("s/test_index.txt");
    assert_eq!(folder.fault(), format!("DIR/s/spectrum: no image matches a row of tx_pos.csv; {LAYOUT}"));
}

/// The measured spectra and their folder, if available.
fn measured() -> Option<(PathBuf, Dataset)> {
    let root = shared("data/s23")?;
    let start = std::time::Instant::now();
    let data = Nerf2Spectrum { root: root.clone(), ..Default::default() }.load(Path::new("."), &|_, _| {}).unwrap();
    println!("{} spectra in {:.2} s", data.len(), start.elapsed().as_secs_f64());
    Some((root, data))
}

#[test]
fn reads_measured_spectra() {
    let Some((_, data)) = measured() else { return };
    assert_eq!(data.title, "s23 (measured, NeRF2 layout)");
    assert!(!data.is_simulated());
    assert_eq!((data.width, data.height, data.len()), (360, 90, 4898));
    assert_eq!((data.sample(0).id, data.sample(0).position()), (1, [-0.327, -0.583, 1.019]));
    assert_eq!(data.sample(4897).id, 6123);
    let (train, test) = data.official.unwrap();
    assert_eq!((train.len(), test.len()), (3918, 980));
    assert!((0..4898).map(|i| data.observations.raw(i)).all(|s| s.contains(&0) && s.contains(&255)));
}

/// Independent check: the file has four decimals, so whole tenths of a millimetre decide.
#[test]
fn voxel_split_of_measured_spectra_shares_no_cell() {
    let Some((root, data)) = measured() else { return };
    let text = fs::read_to_string(root.join("tx_pos.csv")).unwrap();
    let tenths = |field: &str| field.trim().replace('.', "").parse::<i64>().unwrap();
    let places: Vec<Vec<i64>> = text.lines().skip(1).map(|row| row.split(',').map(tenths).collect()).collect();
    let position = |i: &usize| &places[data.sample(*i).id as usize - 1];
    let samples: Vec<usize> = (0..data.len()).collect();
    assert_eq!(samples.iter().filter(|i| position(i).iter().any(|v| v % 2000 == 0)).count(), 81, "samples on a wall");
    let cells = |part: &[usize]| -> BTreeSet<Vec<i64>> {
        part.iter().map(|i| position(i).iter().map(|v| v.div_euclid(2000)).collect()).collect()
    };
    for seed in 0..3 {
        let partition = Voxel::default().split(&data, &mut rng::stream(seed, "split", 0)).unwrap();
        let [train, validation, test] =
            [partition.train, partition.validation, partition.test].map(|part| cells(&part));
        assert_eq!(train.len() + validation.len() + test.len(), cells(&samples).len());
    }
}
