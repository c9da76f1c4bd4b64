//! `Colmap`: images of a moving camera with their poses, in the text format of COLMAP.

#[cfg(test)]
mod tests;

use crate::colormap::Colormap;
use crate::folder::{
    check_root, existing_root, find_point_cloud, folder_name, read_point_cloud, read_title, recognised_root,
};
use crate::text::{TextField, TextRow, XyzColumns, numbered_lines, read_text};
use crate::{nerf2::index, pictures};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{
    Camera, DataSource, Dataset, Ends, Error, JsonSchema, Pose, Progress, Receiver, Result, Sample, Task,
    position_fault,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

const LAYOUT: &str = "a COLMAP folder holds sparse/0/cameras.txt, sparse/0/images.txt and images/";
/// Folders of the model; the second is that of `colmap image_undistorter`.
const MODELS: [&str; 2] = ["sparse/0", "sparse"];
/// Camera models with their numbers of focal lengths and of distortion parameters.
const CAMERAS: [(&str, usize, usize); 5] =
    [("SIMPLE_PINHOLE", 1, 0), ("PINHOLE", 2, 0), ("SIMPLE_RADIAL", 1, 1), ("RADIAL", 1, 2), ("OPENCV", 2, 4)];
const TO_TEXT: &str = "colmap model_converter --output_type TXT";
const UNDISTORT: &str = "run `colmap image_undistorter`, and read its output folder";
const ONE_CAMERA: &str =
    "give all images one camera: run COLMAP with --ImageReader.single_camera 1, or keep the images of one";
const CAMERA_LINE: &str = "write CAMERA_ID MODEL WIDTH HEIGHT and the parameters of the model";
const IMAGE_LINE: &str =
    "write IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and then the line of its 2D points, which may be empty";
const POINT_LINE: &str = "write POINT3D_ID X Y Z R G B ERROR, and then the track";

/// Images of a moving camera, with poses in the text format of COLMAP, as RF-3DGS uses it. The transmitter is fixed.
///
/// ```text
/// root/sparse/0/cameras.txt     one pinhole camera: SIMPLE_PINHOLE or PINHOLE; or sparse/cameras.txt
/// root/sparse/0/images.txt      pose of each image: quaternion and translation from the world to the camera
/// root/sparse/0/points3D.txt    optional point cloud for the initialiser PointCloud
/// root/images/NAME              grey or colour, 8 or 16 bits, PNG or JPEG; all of one size
/// root/train_index.txt          image names, with or without extension, one per line; the files train_index.txt
/// root/test_index.txt           and test_index.txt must both exist or both be absent
/// ```
///
/// Pixel values are luminance, 0 to 1, stored with 8 bits. Colours become luminance, and transparency is ignored. Samples are
/// in the order of the image names; ids count from 1. Train with `projector: Pinhole()`.
///
/// The reconstruction of COLMAP has no unit. The numbers count as metres, so scale the model if settings in metres, such as
/// `near_m`, do not fit. Models with lens distortion are rejected if a distortion parameter is not zero: run
/// `colmap image_undistorter`. Binary models are rejected: run `colmap model_converter --output_type TXT`.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let data = Plugin::<dyn DataSource>::parse(r#"Colmap(root: "data/lobby", transmitter: (0.0, 2.0, 1.5))"#);
/// assert!(data.is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Colmap {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Folder of the images, relative to `root`.
    pub images: PathBuf,
    /// Point cloud (PLY, XYZ or CSV, metres, world frame) instead of `points3D.txt`, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub points: Option<PathBuf>,
    /// Position of the fixed transmitter, metres, world frame, for `inspect` and figures. Predictions do not depend on it.
    pub transmitter: Option<[f64; 3]>,
    /// Colour map of images that were saved as figures; pixels are then the values of its colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colormap: Option<Colormap>,
}

impl Default for Colmap {
    fn default() -> Self {
        Self { root: "data/lobby".into(), images: "images".into(), points: None, transmitter: None, colormap: None }
    }
}

#[typetag::serde]
impl DataSource for Colmap {
    fn task(&self) -> Option<Task> {
        Some(Task::Spectrum)
    }

    /// Loads the model before the images, so that errors of text files come before decoding.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Colmap", LAYOUT)?;
        let model = find_model_folder(&root)?;
        let cameras = read_cameras(&model.join("cameras.txt"))?;
        let views = read_views(&model.join("images.txt"))?;
        let shared = shared_camera(&model, &views, &cameras)?;
        let names = indices_by_name(&views);
        let official = index::read_sets(&root, &|word| parse_entry(&names, &views[0].name, word))?;
        let points = match &self.points {
            Some(points) => read_point_cloud(base, Some(points))?,
            None => read_points3d(&model.join("points3D.txt"))?,
        };
        let paths: Vec<PathBuf> = views.iter().map(|view| root.join(&self.images).join(&view.name)).collect();
        let paths: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
        let advice = "add the image, or remove its two lines from images.txt";
        let decode = |path: &Path| pictures::decode_luminance(path, advice, self.colormap);
        let spectra = pictures::load_spectra(&paths, &decode, progress)?;
        let size = (spectra.width(), spectra.height());
        if size != shared.size {
            let ((w, h), (width, height)) = (size, shared.size);
            let problem = format!("is {w} x {h} pixels, but its camera in cameras.txt {width} x {height}");
            let advice = "use the images that COLMAP read, or correct cameras.txt";
            return Err(Error::input(paths[0], format!("{problem}; {advice}")));
        }
        let samples: Vec<Sample> = (1..).zip(&views).map(|(id, view)| Sample::new(id, view.pose)).collect();
        let receiver = Receiver { camera: Some(shared.camera), ..Receiver::new("camera", views[0].pose) };
        let ends = Ends::of_moving_receivers(vec![receiver], self.transmitter);
        let name = folder_name(&root);
        let (title, simulation) = read_title(&root, &name, "COLMAP");
        let data = Dataset::of_links(title, ends, points, &samples, spectra.into())?;
        Ok(Dataset { official, simulation, ..data })
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let files = MODELS.map(|model| ["txt", "bin"].map(|kind| format!("{model}/images.{kind}")));
        let files = files.as_flattened().iter().map(String::as_str).collect::<Vec<_>>();
        let root = recognised_root(folder, &files)?;
        Some(Box::new(Self { points: find_point_cloud(&root), root, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        let fault = self.transmitter.and_then(position_fault);
        fault.map_or(Ok(()), |fault| Err(format!("`transmitter` {fault}")))
    }
}

/// Returns the folder of the text files of the model in `root`. Returns an error if there is none, or only a binary model.
fn find_model_folder(root: &Path) -> Result<PathBuf> {
    let folder = |file: &str| MODELS.map(|model| root.join(model)).into_iter().find(|model| model.join(file).exists());
    match (folder("images.txt"), folder("images.bin")) {
        (Some(model), _) => Ok(model),
        (None, Some(binary)) => {
            let folder = binary.display();
            let problem = format!("is a binary model; run `{TO_TEXT} --input_path {folder} --output_path {folder}`");
            Err(Error::input(&binary.join("images.bin"), problem))
        }
        (None, None) => Err(Error::input(root, format!("no sparse/0/images.txt; {LAYOUT}"))),
    }
}

/// Camera of `cameras.txt`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SizedCamera {
    size: (usize, usize),
    camera: Camera,
}

/// Image of `images.txt`.
struct View {
    /// Line of the pose, counted from 1.
    line: usize,
    name: String,
    /// Id of the camera.
    camera: u32,
    pose: Pose,
}

/// Returns whether a line has data: it is neither blank nor a comment.
fn is_data_line(line: &str) -> bool {
    !line.trim().is_empty() && !line.trim_start().starts_with('#')
}

/// Parses a whole number: an id, a width or a height. Returns an error with the next step `advice` for other text, or a
/// number beyond 32 bits.
fn parse_whole_number(row: &TextRow<'_>, field: TextField<'_>, advice: &str) -> Result<u32> {
    let fault = || row.fault(field.column, format!("{} is not a whole number; {advice}", quoted(field.text)));
    field.text.parse().ok().ok_or_else(fault)
}

/// Reads the cameras of `cameras.txt` by id. Returns an error for an invalid line, a distorted camera or a repeated id.
fn read_cameras(path: &Path) -> Result<BTreeMap<u32, SizedCamera>> {
    let text = read_text(path, MAX_TEXT, LAYOUT)?;
    let mut cameras = BTreeMap::new();
    for content in numbered_lines(&text).filter(|(_, content)| is_data_line(content)) {
        let row = TextRow::split_at_blanks(path, content);
        let fault = |column, problem: String| Err(row.fault(column, problem));
        let [id, model, width, height, parameters @ ..] = &row.fields[..] else {
            return fault(1, format!("has {} fields; {CAMERA_LINE}", row.fields.len()));
        };
        let Some((_, focal, distortion)) = CAMERAS.into_iter().find(|(name, ..)| *name == model.text) else {
            return fault(model.column, format!("camera model {} is no pinhole; {UNDISTORT}", quoted(model.text)));
        };
        // Focal lengths, the principal point (x, y), and distortion, in this order.
        let needed = focal + 2 + distortion;
        if parameters.len() != needed {
            let problem = format!("{} has {} parameters, expected {needed}", model.text, parameters.len());
            return fault(model.column, format!("{problem}; {CAMERA_LINE}"));
        }
        let values = parameters.iter().map(|field| row.number(*field, CAMERA_LINE)).collect::<Result<Vec<_>>>()?;
        if let Some(k) = (focal + 2..needed).find(|k| values[*k] != 0.0) {
            return fault(parameters[k].column, format!("the lens distortion is not zero; {UNDISTORT}"));
        }
        let size = [width, height].map(|field| parse_whole_number(&row, *field, CAMERA_LINE));
        let [width, height] = size.map(|side| side.map(|side| side as usize));
        let camera = Camera { focal: [values[0], values[focal - 1]], centre: [values[focal], values[focal + 1]] };
        if let Some(problem) = camera.fault() {
            return fault(parameters[0].column, problem);
        }
        let id = parse_whole_number(&row, *id, CAMERA_LINE)?;
        if cameras.insert(id, SizedCamera { size: (width?, height?), camera }).is_some() {
            return fault(1, format!("a second camera {id}; remove one of the two"));
        }
    }
    Ok(cameras)
}

/// Reads the images of `images.txt` and sorts them by name. Each has two lines: pose and name, then its 2D points. Returns
/// an error for an invalid line, a repeated name or no image.
fn read_views(path: &Path) -> Result<Vec<View>> {
    let text = read_text(path, MAX_TEXT, LAYOUT)?;
    let mut views = Vec::new();
    let mut rows = (1..).zip(text.lines());
    while let Some((line, content)) = rows.next() {
        if !is_data_line(content) {
            continue;
        }
        let view = parse_view(&TextRow::split_at_blanks(path, (line, content)))?;
        if let Some((line, points)) = rows.next()
            && !points.split_whitespace().count().is_multiple_of(3)
        {
            let problem = format!("expected the 2D points of {}, three numbers each", quoted(&view.name));
            return Err(Error::at(path, line, 1, format!("{problem}; {IMAGE_LINE}")));
        }
        views.push(view);
    }
    views.sort_by(|a, b| a.name.cmp(&b.name));
    if views.is_empty() {
        return Err(Error::input(path, format!("has no image; {IMAGE_LINE}")));
    }
    match views.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some([first, second]) => {
            let problem = format!("image {} is also in line {}", quoted(&first.name), first.line);
            Err(Error::at(path, second.line, 1, format!("{problem}; remove one of the two")))
        }
        _ => Ok(views),
    }
}

/// Parses the first line of an image: its name, camera and pose. The camera frame of COLMAP is v = R·x + t, so that the
/// camera is at -Rᵀ·t. Returns an error for another number of fields, an invalid number or rotation, or a name that
/// leaves the folder of images.
fn parse_view(row: &TextRow<'_>) -> Result<View> {
    let count = row.fields.len();
    let [_, w, x, y, z, t @ .., camera, name] = &row.fields[..] else {
        return Err(row.fault(1, format!("has {count} fields, expected 10; {IMAGE_LINE}")));
    };
    let &[tx, ty, tz] = t else {
        let expected = "10; names of images have no blanks";
        return Err(row.fault(1, format!("has {count} fields, expected {expected}; {IMAGE_LINE}")));
    };
    let [qx, qy, qz, qw] = [x, y, z, w].map(|field| row.coordinate(*field, IMAGE_LINE));
    let rotation = Pose { position: [0.0; 3], orientation: [-qx?, -qy?, -qz?, qw?] }; // world from camera
    if let Some((_, fault)) = rotation.fault() {
        return Err(row.fault(w.column, fault));
    }
    let position = rotation.turned(row.position([tx, ty, tz], IMAGE_LINE)?.map(|t| -t));
    if !Path::new(name.text).components().all(|part| matches!(part, Component::Normal(_))) {
        let problem = format!("{} is not the path of an image within images/; correct the name", quoted(name.text));
        return Err(row.fault(name.column, problem));
    }
    let camera = parse_whole_number(row, *camera, IMAGE_LINE)?;
    Ok(View { line: row.line, name: name.text.into(), camera, pose: Pose { position, ..rotation } })
}

/// Returns the camera of all `views`, at least one, of the model in the folder `model`. Returns an error if their cameras
/// differ or one is missing.
fn shared_camera(model: &Path, views: &[View], cameras: &BTreeMap<u32, SizedCamera>) -> Result<SizedCamera> {
    let mut used: BTreeMap<u32, usize> = BTreeMap::new();
    views.iter().for_each(|view| _ = used.entry(view.camera).or_insert(view.line));
    let mut shared: Option<(u32, SizedCamera)> = None;
    for (id, line) in used {
        let Some(camera) = cameras.get(&id) else {
            let problem = format!("camera {id} is not in cameras.txt; add its line, or correct CAMERA_ID");
            return Err(Error::at(&model.join("images.txt"), line, 1, problem));
        };
        match shared {
            Some((first, other)) if other != *camera => {
                let problem = format!("cameras {first} and {id} differ; {ONE_CAMERA}");
                return Err(Error::input(&model.join("cameras.txt"), problem));
            }
            Some(_) => {}
            None => shared = Some((id, *camera)),
        }
    }
    Ok(shared.expect("there is an image").1)
}

/// Index of each image by its name with and without extension; `None` for a stem of several images.
type ImageNames = BTreeMap<String, Option<usize>>;

/// Returns the indices of the images by their names.
fn indices_by_name(views: &[View]) -> ImageNames {
    let mut names = BTreeMap::new();
    for (k, view) in views.iter().enumerate() {
        let stem = Path::new(&view.name).with_extension("").to_string_lossy().into_owned();
        names.entry(stem).and_modify(|index| *index = None).or_insert(Some(k));
    }
    names.extend(views.iter().enumerate().map(|(k, view)| (view.name.clone(), Some(k))));
    names
}

/// Parses a word of an index file: the name of an image, with or without extension. Returns the problem with an unknown or
/// ambiguous name; its advice names `example`.
fn parse_entry(names: &ImageNames, example: &str, word: &str) -> Result<index::IndexEntry, String> {
    match names.get(word) {
        Some(Some(k)) => Ok(index::IndexEntry { id: *k as u32 + 1, sample: *k }),
        Some(None) => Err(format!("{} names several images; write the extension too", quoted(word))),
        None => Err(format!("{} is no image of images.txt; write names such as {}", quoted(word), quoted(example))),
    }
}

/// Reads the point cloud of the reconstruction, metres; empty without the file. Returns an error for an invalid line.
fn read_points3d(path: &Path) -> Result<Vec<[f64; 3]>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = read_text(path, MAX_TEXT, LAYOUT)?;
    let rows = numbered_lines(&text).filter(|(_, content)| is_data_line(content));
    rows.map(|content| XyzColumns([1, 2, 3]).read(&TextRow::split_at_blanks(path, content), POINT_LINE)).collect()
}
