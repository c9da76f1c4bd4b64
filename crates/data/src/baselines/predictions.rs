//! `Predictions`: predictions of another program for the test set, read from a folder.

use crate::dialect::read_columns;
use crate::folder::list_numbered_files;
use crate::text::read_bytes;
use pwrfgs_core::files::MAX_NUMBERS;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::npy::Header;
use pwrfgs_core::{
    Baseline, Dataset, Error, FittingSet, Image, JsonSchema, Predict, Query, Real, Result, files, gain_fault, rows_of,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// File with the predictions of received powers.
const POWERS: &str = "predictions.csv";
/// Next step if files and test set differ.
const ADVICE: &str = "give one prediction per test id; `pwrfgs compare DATA --split-csv FILE` lists the ids";
/// Largest absolute value of a predicted spectrum, whose values are from 0 to 1.
const LARGEST: Real = 2.0;

/// Predictions of another program for the test set, scored like a baseline.
///
/// The folder holds one file per test id, such as `00012.npy`, and no file for other ids:
///
/// - spectra: float32 [elevation, azimuth], linear, 0 to 1;
/// - channels: complex64 [antennas, subcarriers].
///
/// Received powers are in `predictions.csv`, with the columns `id` and `dbm`. With several receivers, the column `link`
/// replaces `id`, and files have the number of the link. `pwrfgs compare` lists all ids and sets this baseline. The
/// training set of the predictions is not checked.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// let baseline = Plugin::<dyn Baseline>::parse(r#"Predictions(name: "U-Net", root: "../predicted")"#).unwrap();
/// assert_eq!(baseline.name(), "U-Net");
/// assert!(Plugin::<dyn Baseline>::parse(r#"Predictions(name: "model")"#).is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Predictions {
    /// Name in tables.
    pub name: String,
    /// Folder of the predictions, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Digest of all files, which `pwrfgs compare` sets so that changed predictions are scored again.
    pub digest: String,
}

impl Default for Predictions {
    fn default() -> Self {
        Self { name: "predictions".into(), root: "predicted".into(), digest: String::new() }
    }
}

/// One prediction.
#[derive(Clone, Debug)]
enum Prediction {
    File(PathBuf),
    Power(Real),
}

impl Predictions {
    /// Computes and stores the digest of the predictions for `data` and of its positions, so that [`Baseline::check_test`]
    /// rejects later changes.
    ///
    /// # Errors
    /// The folder or a file is missing or cannot be read, two files have one id, or the table of powers has a missing
    /// column or an invalid or repeated row.
    pub fn set_digest(&mut self, data: &Dataset) -> Result<()> {
        self.digest = self.compute_digest(data)?;
        Ok(())
    }

    /// Returns the digest of all predictions for `data` and of its positions. Returns the errors of [`Self::set_digest`].
    fn compute_digest(&self, data: &Dataset) -> Result<String> {
        let mut text = String::new();
        (0..data.len()).for_each(|i| _ = writeln!(text, "{:?}", data.sample(i).position()));
        for (id, prediction) in self.predictions_by_label(data)? {
            let content = match prediction {
                Prediction::File(path) => files::digest(&files::read(&path).map_err(|e| Error::read(&path, e))?),
                Prediction::Power(dbm) => dbm.to_string(),
            };
            _ = writeln!(text, "{id} {content}");
        }
        Ok(files::digest(text.as_bytes()))
    }

    /// Returns the predictions by label of the sample: lists files, or reads the table of powers. Returns an error for a missing
    /// folder or table, or a repeated label.
    fn predictions_by_label(&self, data: &Dataset) -> Result<BTreeMap<u32, Prediction>> {
        if data.task().is_scalar {
            let key = if data.scene.receivers.len() > 1 { "link" } else { "id" };
            return read_power_predictions(&self.root.join(POWERS), key);
        }
        let paths = list_numbered_files(&self.root, "npy", ADVICE)?;
        Ok(paths.into_iter().map(|(id, path)| (id, Prediction::File(path))).collect())
    }
}

/// Reads a table of powers with the columns `key` and `dbm`: the predictions by label. Returns an error for an invalid or
/// repeated row.
fn read_power_predictions(path: &Path, key: &str) -> Result<BTreeMap<u32, Prediction>> {
    let mut predictions = BTreeMap::new();
    read_columns(path, [key, "dbm"], ADVICE, |row| {
        let [id, power] = row.fields;
        let fault = |problem| row.fault(id.column, format!("{key} {} {problem}; {ADVICE}", quoted(id.text)));
        let label = id.text.parse().ok().ok_or_else(|| fault("is not a whole number"))?;
        let dbm = row.power(power, &[])?;
        let dbm = dbm.ok_or_else(|| row.fault(power.column, "no power; give one per link, or remove the row"))?;
        let power = Prediction::Power(dbm as Real);
        predictions.insert(label, power).map_or(Ok(()), |_| Err(fault("occurs twice")))
    })?;
    Ok(predictions)
}

impl Prediction {
    /// Reads the prediction as an observation like those of `data`. Returns an error for another type or shape, or a value
    /// out of range.
    fn read_image(&self, data: &Dataset) -> Result<Image> {
        let (task, width, height) = (data.task(), data.width, data.height);
        let path = match self {
            Self::Power(dbm) => return Ok(Image { width, height, pixels: vec![*dbm] }),
            Self::File(path) => path,
        };
        let refuse = |problem: String| Err(Error::input(path, problem));
        let bytes = read_bytes(path, MAX_NUMBERS, ADVICE)?;
        let Header { descr, fortran, shape, offset } = Header::read(path, &mut &bytes[..])?;
        // An image of channels has two rows per antenna: real and imaginary parts.
        let (expected, size, axes, parts) = if task.is_complex {
            ("<c8", [height / 2, width], "[antennas, subcarriers]", 2)
        } else {
            ("<f4", [height, width], "[elevation, azimuth]", 1)
        };
        if descr != expected {
            return refuse(format!(
                "has numbers of type `{descr}`, expected `{expected}`; save a.astype('{expected}')"
            ));
        }
        if shape != size || fortran {
            let advice = format!("save numpy.ascontiguousarray(a), one array {axes} per id");
            return refuse(format!("has shape {shape:?}, expected {size:?} in C order; {advice}"));
        }
        let numbers = bytes[offset as usize..].as_chunks().0;
        let pixels: Vec<Real> = numbers.iter().map(|b| f32::from_le_bytes(*b) as Real).collect();
        if 4 * pixels.len() as u64 + offset != bytes.len() as u64 || pixels.len() != width * height {
            return refuse("does not have the length of its shape; the file is damaged: save it again".into());
        }
        let is_wrong = |v: &Real| gain_fault([*v as f64, 0.0]).is_some() || (task.has_pixels && v.abs() > LARGEST);
        if let Some(i) = pixels.iter().position(is_wrong) {
            let index = [i / parts / width, i / parts % width];
            let range = if parts == 1 { ", linear, 0 to 1" } else { " up to 1e9" };
            return refuse(format!("the value at {index:?} is {}; give finite numbers{range}", pixels[i]));
        }
        let pixels = if task.is_complex { rows_of(pixels.as_chunks().0, width) } else { pixels };
        Ok(Image { width, height, pixels })
    }
}

#[typetag::serde]
impl Baseline for Predictions {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn is_external(&self) -> bool {
        true
    }

    fn check(&self) -> Result<(), String> {
        let is_free = !self.name.trim().is_empty() && self.name != "model"; // the row of the model in tables
        is_free.then_some(()).ok_or_else(|| format!("`name` is `{}`; give the name of your method", self.name))
    }

    fn check_test(&self, data: &Dataset, test: &[usize]) -> Result<()> {
        if !self.digest.is_empty() && self.digest != self.compute_digest(data)? {
            let problem =
                "holds other predictions, or predictions for other data, than were compared; repeat `pwrfgs compare`";
            return Err(Error::input(&self.root, problem));
        }
        let predictions = self.predictions_by_label(data)?;
        let (given, expected): (BTreeSet<u32>, BTreeSet<u32>) =
            (predictions.keys().copied().collect(), test.iter().map(|&i| data.label(i)).collect());
        let test_set = if data.scene.receivers.len() == 1 { "test ids" } else { "test links" };
        for (problem, ids) in [
            (format!("{test_set} without prediction"), expected.difference(&given).collect::<Vec<_>>()),
            (format!("predictions that are not for {test_set}"), given.difference(&expected).collect()),
        ] {
            if let Some(first) = ids.first() {
                let message = format!("{problem}: {}, such as {first}; {ADVICE}", ids.len());
                return Err(Error::input(&self.root, message));
            }
        }
        predictions.values().try_for_each(|prediction| prediction.read_image(data).map(drop))
    }

    fn fit<'a>(&self, data: &'a Dataset, _: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        let by_label = self.predictions_by_label(data)?;
        let prediction = |i: usize| {
            let sample = data.sample(i);
            Some(((sample.id, sample.receiver), by_label.get(&data.label(i))?.clone()))
        };
        let predictions = (0..data.len()).filter_map(prediction).collect();
        Ok(Box::new(External { data, name: self.name.clone(), predictions }))
    }
}

/// Predictions by id and receiver. Files are read when needed, so that memory does not grow with their number.
struct External<'a> {
    data: &'a Dataset,
    name: String,
    predictions: BTreeMap<(u32, usize), Prediction>,
}

impl Predict for External<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let prediction = query.id.and_then(|id| self.predictions.get(&(id, query.receiver)));
        // A file that has disappeared since the check: callers refuse numbers that are not finite.
        prediction.and_then(|prediction| prediction.read_image(self.data).ok()).unwrap_or_else(|| {
            let (width, height) = (self.data.width, self.data.height);
            Image { width, height, pixels: vec![Real::NAN; width * height] }
        })
    }

    fn note(&self) -> Option<String> {
        Some(format!("{}: predictions of another program; its training set is not checked", self.name))
    }
}
