//! A small COLMAP folder, and errors of invalid content.

use super::*;
use image::{GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use pwrfgs_core::{End, Plugin, recognise};
use std::fs;

const CAMERA: &str = "# a comment\n7 PINHOLE 4 3 5.0 6.0 2.0 1.5\n";
/// A camera at (1, 2, 3) that looks along world x; one at the origin with the axes of the world.
const IMAGES: &str =
    "# a comment\n2 0.5 0.5 -0.5 0.5 2 3 -1 7 b.png\n1.5 2.5 -1 0.5 0.5 9\n\n1 1 0 0 0 0 0 0 7 part/a.jpg\n\n";

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::create_dir_all(folder.path("sparse/0")).unwrap();
        fs::create_dir_all(folder.path("images/part")).unwrap();
        folder.write("sparse/0/cameras.txt", CAMERA);
        folder.write("sparse/0/images.txt", IMAGES);
        folder.write("sparse/0/points3D.txt", "# id\n1 1.0 2.0 3.0 255 0 0 0.5 1 2\n2 4 5 6 0 0 0 0.1\n");
        RgbImage::from_pixel(4, 3, Rgb([255, 0, 0])).save(folder.path("images/b.png")).unwrap();
        let grey = GrayImage::from_pixel(4, 3, Luma([128]));
        grey.save_with_format(folder.path("images/part/a.jpg"), ImageFormat::Jpeg).unwrap();
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join("s").join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap();
    }

    fn try_load(&self) -> Result<Dataset> {
        Colmap { root: "s".into(), ..Colmap::default() }.load(self.0.path(), &|_, _| {})
    }

    fn fault(&self) -> String {
        let error = self.try_load().unwrap_err();
        assert!(error.is_input(), "{error}");
        error.to_string().replace(&self.path("").display().to_string(), "")
    }
}

fn assert_near(actual: [f64; 3], expected: [f64; 3]) {
    assert!(actual.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{actual:?} is not {expected:?}");
}

#[test]
fn reads_poses_camera_points_and_luminance() {
    let folder = Folder::new();
    let data = folder.try_load().unwrap();
    assert_eq!((data.title.as_str(), data.width, data.height, data.len()), ("s (measured, COLMAP)", 4, 3, 2));
    assert_eq!(data.camera(), Some(Camera { focal: [5.0, 6.0], centre: [2.0, 1.5] }));
    assert_eq!((data.plane().camera, data.plane().angles, data.plane().wraps), (data.camera(), None, false));
    // In the order of names: b.png, then part/a.jpg.
    assert_near(data.sample(0).position(), [1.0, 2.0, 3.0]);
    assert_eq!(data.sample(1).position(), [0.0; 3]);
    let pose = data.query(0).pose;
    assert_near(pose.turned([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]); // forward
    assert_near(pose.turned([1.0, 0.0, 0.0]), [0.0, -1.0, 0.0]); // right
    assert_near(pose.turned([0.0, 1.0, 0.0]), [0.0, 0.0, -1.0]); // down
    assert_eq!(data.observations.raw(0).as_ref(), [54; 12]); // 0.2126 of 255
    assert_eq!(data.observations.raw(1).as_ref(), [128; 12]);
    assert_eq!(data.scene.points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!((data.scene.transmitter, data.scene.moving), (None, End::Receiver));
    assert!(data.official.is_none() && !data.is_simulated());
    let part = data.subset(&[1]).unwrap();
    assert_eq!((part.camera(), part.query(0).pose), (data.camera(), data.query(1).pose));
    assert!(crate::save(&data, &folder.path("out")).unwrap_err().to_string().contains("keep the original files"));
    crate::check_dataset(&data).unwrap();
}

/// The shared folder of images in colours of jet, and that of the same images in grey.
#[test]
fn images_of_a_colour_map_are_refused_or_inverted() {
    let Some(cases) = pwrfgs_core::testing::shared("cases/radio") else { return };
    let load = |name: &str, colormap| {
        Colmap { root: cases.join(name), colormap, ..Colmap::default() }.load(Path::new(""), &|_, _| {})
    };
    let (grey, jet) = (load("images-grey", None).unwrap(), load("images-jet", Some(Colormap::Jet)).unwrap());
    for k in 0..12 {
        let pair = (grey.observations.raw(k), jet.observations.raw(k));
        let far = pair.0.iter().zip(pair.1.iter()).filter(|(a, b)| a.abs_diff(**b) > 2).count();
        assert!(far <= 2, "six values have one colour: {far} pixels");
    }
    let refused = load("images-jet", None).unwrap_err().to_string();
    assert!(refused.contains("the colour map jet") && refused.contains("`colormap: Jet` of `Colmap`"), "{refused}");
    assert!(
        load("images-grey", Some(Colormap::Jet)).unwrap_err().to_string().contains("is grey, not in colours of jet")
    );
}

#[test]
fn reads_split_distortion_of_zero_and_other_folders() {
    let folder = Folder::new();
    folder.write("train_index.txt", "b\n");
    folder.write("test_index.txt", "part/a.jpg\n");
    folder.write("manifest.json", r#"{"simulated": true}"#);
    folder.write("sparse/0/cameras.txt", "7 OPENCV 4 3 5 6 2 1.5 0 0 0 0\r\n8 OPENCV 4 3 5 6 2 1.5 0.0 0 -0 0\r\n");
    folder.write("sparse/0/images.txt", IMAGES.replace("0 0 7 part", "0 0 8 part").replace('\n', "\r\n"));
    let data = folder.try_load().unwrap();
    assert_eq!((data.official, data.simulation.is_some()), (Some((vec![0], vec![1])), true));
    folder.write("train_index.txt", "c\n");
    assert_eq!(folder.fault(), "train_index.txt:1:1: `c` is no image of images.txt; write names such as `b.png`");
    fs::remove_file(folder.path("train_index.txt")).unwrap();
    fs::remove_file(folder.path("test_index.txt")).unwrap();
    // The layout of `colmap image_undistorter`, other images, and another point cloud.
    fs::rename(folder.path("sparse/0"), folder.path("model")).unwrap();
    fs::remove_dir(folder.path("sparse")).unwrap();
    fs::rename(folder.path("model"), folder.path("sparse")).unwrap();
    fs::rename(folder.path("images"), folder.path("small")).unwrap();
    folder.write("points.csv", "x,y,z\n1,1,1\n");
    let source = recognise(&folder.path("")).unwrap();
    assert!(pwrfgs_core::plugin::to_ron(&source).contains("points.csv"));
    let source = Colmap { root: folder.path(""), images: "small".into(), ..Colmap::default() };
    let source = Colmap { transmitter: Some([0.0, 0.0, 9.0]), points: Some(folder.path("points.csv")), ..source };
    let scene = source.load(Path::new(""), &|_, _| {}).unwrap().scene;
    assert_eq!((scene.pose().position, scene.points), ([0.0, 0.0, 9.0], vec![[1.0; 3]]));
    // Without points.
    fs::remove_file(folder.path("sparse/points3D.txt")).unwrap();
    assert!(Colmap { points: None, ..source }.load(Path::new(""), &|_, _| {}).unwrap().scene.points.is_empty());
}

#[test]
fn reports_invalid_files_with_line_and_advice() {
    let with = |name: &str, text: &str| {
        let folder = Folder::new();
        folder.write(name, text);
        folder.fault()
    };
    let camera = |line: &str| with("sparse/0/cameras.txt", line);
    let image = |from: &str, to: &str| with("sparse/0/images.txt", &IMAGES.replace(from, to));
    let cases = [
        (
            camera("7 OPENCV 4 3 5 6 2 1.5 0.1 0 0 0"),
            "cameras.txt:1:24: the lens distortion is not zero; run `colmap image_und",
        ),
        (
            camera("7 FULL_OPENCV 4 3 5"),
            "cameras.txt:1:3: camera model `FULL_OPENCV` is no pinhole; run `colmap image_undistorter`",
        ),
        (camera("7 PINHOLE 4 3 5 6 2"), "cameras.txt:1:3: PINHOLE has 3 parameters, expected 4; write CAMERA_ID MODEL"),
        (camera("7 PINHOLE 4"), "cameras.txt:1:1: has 3 fields; write CAMERA_ID"),
        (camera("7 PINHOLE 4 3.5 5 6 2 1"), "cameras.txt:1:13: `3.5` is not a whole number"),
        (camera("7 PINHOLE 4 3 -5 6 2 1"), "cameras.txt:1:15: a camera with focal lengths [-5.0, 6.0]"),
        (camera("7 PINHOLE 4 3 nan 6 2 1"), "cameras.txt:1:15: `nan` is not finite"),
        (camera("6 PINHOLE 4 3 5 6 2 1"), "images.txt:2:1: camera 7 is not in cameras.txt; add its line"),
        (camera("7 PINHOLE 4 3 5 6 2 1\n7 PINHOLE 4 3 5 6 2 1"), "cameras.txt:2:1: a second camera 7"),
        (
            camera("7 PINHOLE 8 6 5 6 2 1"),
            "images/b.png: is 4 x 3 pixels, but its camera in cameras.txt 8 x 6; use the images",
        ),
        (image("2 0.5 0.5 -0.5 0.5", "2 0.5 0.5 -0.5 0.6"), "images.txt:2:3: the quaternion has length 1.053565"),
        (image("2 3 -1 7 b.png", "2 3 1e9 7 b.png"), "images.txt:2:24: `1e9` is beyond 1e8 m"),
        (image("2 3 -1 7 b.png", "2 x -1 7 b.png"), "images.txt:2:22: `x` is not a number; write IMAGE_ID QW QX"),
        (image("7 b.png", "7 b c.png"), "images.txt:2:1: has 11 fields, expected 10; names of images have no blanks"),
        (image("7 b.png", "b.png"), "images.txt:2:1: has 9 fields, expected 10"),
        (image("7 b.png", "7 ../b.png"), "images.txt:2:29: `../b.png` is not the path of an image within images/"),
        (image("7 b.png", "-7 b.png"), "images.txt:2:27: `-7` is not a whole number"),
        (
            image("1.5 2.5 -1 0.5 0.5 9\n\n", ""),
            "images.txt:3:1: expected the 2D points of `b.png`, three numbers each",
        ),
        (image("part/a.jpg", "b.png"), "images.txt:5:1: image `b.png` is also in line 2; remove one of the two"),
        (
            image("part/a.jpg", "c.png"),
            "cannot read images/c.png: no such file; add the image, or remove its two lines",
        ),
        (with("sparse/0/images.txt", "# nothing\n\n"), "images.txt: has no image; write IMAGE_ID"),
        (
            with("sparse/0/points3D.txt", "1 2 3"),
            "points3D.txt:1:6: the row ends after 3 of the 4 columns that `z` needs",
        ),
        (with("images/b.png", "GIF89a"), "images/b.png: is not a PNG or JPEG image; convert it"),
        (with("images/b.png", "\u{ff}\u{d8}\u{ff}"), "images/b.png: is not a PNG or JPEG image"),
    ];
    for (message, expected) in cases {
        assert!(message.contains(expected), "{message}\n{expected}");
    }
    let folder = Folder::new();
    folder.write("sparse/0/cameras.txt", format!("{CAMERA}8 PINHOLE 4 3 5 6 2 1"));
    folder.write("sparse/0/images.txt", IMAGES.replace("0 0 7 part", "0 0 8 part"));
    let message = folder.fault();
    assert!(message.contains("cameras.txt: cameras 7 and 8 differ; give all images one camera"), "{message}");
    for kind in ["cameras", "images"] {
        let folder = Folder::new();
        fs::rename(folder.path(&format!("sparse/0/{kind}.txt")), folder.path(&format!("sparse/0/{kind}.bin"))).unwrap();
        let message = folder.fault();
        let expected = if kind == "images" { "colmap model_converter --output_type TXT" } else { "no such file" };
        assert!(message.contains(expected) && recognise(&folder.path("")).is_some(), "{message}");
    }
    let refused = |text: &str| Plugin::<dyn DataSource>::parse(text).unwrap_err();
    assert!(refused("Colmap(transmitter: (0.0, 1e9, 0.0))").contains("`transmitter` is 1e9 m, beyond 1e8 m"));
    assert!(refused("Colmap(root: \"\")").contains("`root` is empty"));
}
