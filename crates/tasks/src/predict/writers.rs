//! Output files of predictions: arrays, images and the lines of `predictions.csv`.

use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs_core::files::{self, GrowingFile, PartialFolder};
use pwrfgs_core::{Error, Geodetic, Image, Number, Pose, Query, Real, Result, gains_of};
use pwrfgs_data::{npy_header, npy_header_as};
use pwrfgs_experiment::text::csv_field;
use pwrfgs_model::{Interval, Prepared};
use rayon::prelude::*;
use std::io::{BufRead as _, BufReader};
use std::path::Path;

/// NumPy type of pairs of 32-bit floats.
const COMPLEX: &str = "<c8";
/// Table of all rows.
const LIST: &str = "predictions.csv";
/// Suffix of files with the standard deviation of an ensemble.
const SPREAD: &str = "-spread";

/// Row of `predictions.csv`: pose of the moving end, and receiver.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictionRow<'a> {
    /// Number of the row, from 1.
    pub(super) number: usize,
    /// Pose of the moving end.
    pub(super) pose: Pose,
    /// Index of the receiver.
    pub(super) receiver: usize,
    /// Whether the row has the orientation, of a moving receiver.
    pub(super) has_orientation: bool,
    /// Name of the receiver; none for spectra at a single receiver.
    pub(super) name: Option<&'a str>,
    /// Distance to the nearest training position, metres; none if unknown.
    pub(super) training_distance: Option<f64>,
    /// Latitude and longitude of the frame.
    pub(super) geodetic: Option<Geodetic>,
}

impl PredictionRow<'_> {
    /// Returns the query of the row.
    pub(super) fn query(&self) -> Query<'static> {
        Query::at(self.pose, self.receiver)
    }

    /// Formats the first columns of the row: number, pose and receiver.
    fn first_columns(&self) -> String {
        let (Pose { position: [x, y, z], orientation }, number) = (self.pose, self.number);
        let name = self.name.map_or_else(String::new, |name| format!(",{}", csv_field(name)));
        let turn = if self.has_orientation { orientation.map(|v| format!(",{v}")).concat() } else { String::new() };
        format!("{number},{x},{y},{z}{turn}{name}")
    }

    /// Formats the last columns of the row: distance to the training positions, and degrees of a frame that has them.
    fn last_columns(&self) -> String {
        let distance = self.training_distance.map_or_else(String::new, |metres| format!("{metres:.3}"));
        let degrees = self.geodetic.map_or_else(String::new, |geodetic| geodetic.cells(self.pose.position));
        format!("{distance}{degrees}\n")
    }
}

/// Prediction of one row.
pub(super) struct PredictionImage {
    pub(super) image: Image,
    /// Standard deviation over the members of an ensemble.
    pub(super) spread: Option<Image>,
    pub(super) interval: Option<Interval>,
}

/// Row with its prediction.
pub(super) type PredictedRow<'a> = (PredictionRow<'a>, PredictionImage);

/// Writer of predictions into a folder: arrays, images and `predictions.csv`. A row is complete once it is in `predictions.csv`,
/// after its other files.
pub(super) struct PredictionWriter<'a> {
    folder: &'a PartialFolder,
    model: &'a Prepared<'a>,
    has_png: bool,
    /// Arrays of all predictions; empty if each prediction has files of its own.
    stacks: Vec<GrowingFile>,
    list: GrowingFile,
}

impl<'a> PredictionWriter<'a> {
    /// Creates the writer of predictions of `model` into `folder`, which continues after the complete rows there; also returns
    /// their number. `stacked` is the number of all predictions if these share arrays; `None` if each has a file.
    pub(super) fn resume(
        folder: &'a PartialFolder,
        model: &'a Prepared<'a>,
        has_png: bool,
        has_interval: bool,
        stacked: Option<usize>,
    ) -> Result<(Self, usize)> {
        let stacks: Vec<Stack> = stacked.map_or_else(Vec::new, |count| stacks_of(model, has_interval, count));
        let path = |name: &str| folder.path().join(name);
        let limits = stacks.iter().map(|stack| stack.complete_rows(&path(&stack.name)));
        let limit = limits.min().map_or(usize::MAX, |rows| rows + 1); // with the header
        let (lines, bytes) = complete_lines(&path(LIST), limit)?;
        let rows = lines.saturating_sub(1);
        let list = GrowingFile::resume(path(LIST), list_header(model, has_interval).as_bytes(), bytes)?;
        let open = |Stack { name, header, row_bytes }: Stack| {
            let length = if rows > 0 { header.len() + rows * row_bytes } else { 0 };
            GrowingFile::resume(path(&name), &header, length as u64)
        };
        let stacks = stacks.into_iter().map(open).collect::<Result<_>>()?;
        Ok((Self { folder, model, has_png, stacks, list }, rows))
    }

    /// Writes the files of the next rows, and then adds the rows to the list.
    pub(super) fn write(&mut self, rows: &[PredictedRow<'_>]) -> Result<()> {
        let task = self.model.task();
        if task.has_pixels {
            self.write_spectra(rows)?;
        } else if task.is_complex {
            rows.iter().try_for_each(|(row, drawn)| self.write_channel(row.number, drawn))?;
        }
        self.stacks.iter_mut().try_for_each(GrowingFile::flush)?;
        let line = |(row, drawn): &PredictedRow<'_>| {
            format!("{},{}{}", row.first_columns(), self.format_prediction(drawn), row.last_columns())
        };
        let lines: Vec<String> = rows.par_iter().map(line).collect();
        self.list.append(lines.concat().as_bytes())?;
        self.list.flush()
    }

    /// Formats the columns of a prediction in `predictions.csv`, each with a comma after it. Angles are empty if the
    /// image plane has none.
    fn format_prediction(&self, drawn: &PredictionImage) -> String {
        let (image, interval, task) = (&drawn.image, drawn.interval.as_ref(), self.model.task());
        if task.is_complex {
            return format!("{:.4},", task.level(image));
        }
        if !task.has_pixels {
            let ends = interval.into_iter().flat_map(|interval| [&interval.lower, &interval.upper]);
            let values = std::iter::once(image).chain(&drawn.spread).chain(ends);
            return values.map(|value| format!("{},", value.pixels[0])).collect::<Vec<_>>().concat();
        }
        let strongest = image.argmax();
        let (column, row) = ((strongest % image.width) as Real, (strongest / image.width) as Real);
        let angles = self.model.plane().azimuth_elevation_deg(column, row);
        let angles = angles.map_or_else(|| ",".into(), |(azimuth, elevation)| format!("{azimuth},{elevation}"));
        let bound =
            interval.and_then(|interval| interval.ssim).map_or_else(String::new, |bound| format!("{bound:.4},"));
        format!("{angles},{},{bound}", image.pixels[strongest])
    }

    /// Writes spectra with their deviations and bounds, as arrays and images.
    fn write_spectra(&mut self, rows: &[PredictedRow<'_>]) -> Result<()> {
        let images: Vec<&Image> = rows.iter().map(|(_, drawn)| &drawn.image).collect();
        let spreads: Vec<&Image> = rows.iter().filter_map(|(_, drawn)| drawn.spread.as_ref()).collect();
        let intervals = || rows.iter().filter_map(|(_, drawn)| drawn.interval.as_ref());
        let (lower, upper) = intervals().map(|interval| (&interval.lower, &interval.upper)).unzip();
        // In the order of `stacks_of`. Standard deviations of values in [0, 1] are at most 0.5, so twice them fill the grey
        // scale.
        let kinds = [("", 1.0, images), (SPREAD, 2.0, spreads), ("-lower", 1.0, lower), ("-upper", 1.0, upper)];
        for (k, (suffix, gain, images)) in kinds.iter().filter(|(.., images)| !images.is_empty()).enumerate() {
            let write_image = |(image, (row, _)): (&&Image, &PredictedRow<'_>)| {
                let name = row_name(row.number) + suffix;
                if self.stacks.is_empty() {
                    self.write_array(&name, image)?;
                }
                self.write_png(&name, image, *gain as Real)
            };
            images.par_iter().zip(rows).map(write_image).collect::<Result<Vec<()>>>()?;
            if let Some(stack) = self.stacks.get_mut(k) {
                images.iter().try_for_each(|image| stack.append(&float_bytes(image).collect::<Vec<u8>>()))?;
            }
        }
        Ok(())
    }

    /// Writes the channel of row `number` with its deviation, as arrays `[A, F]`.
    fn write_channel(&mut self, number: usize, PredictionImage { image, spread, .. }: &PredictionImage) -> Result<()> {
        let (gains, name) = (gains_of(&image.pixels, image.width), row_name(number));
        if let Some(stack) = self.stacks.first_mut() {
            stack.append(&complex_bytes(&gains).collect::<Vec<u8>>())?;
        } else {
            let mut npy = npy_header_as(COMPLEX, &[image.height / 2, image.width]);
            npy.extend(complex_bytes(&gains));
            self.folder.put(&format!("{name}.npy"), npy)?;
        }
        let Some(spread) = spread.as_ref().map(complex_deviations) else { return Ok(()) };
        // The second array of `stacks_of`.
        match self.stacks.get_mut(1) {
            Some(stack) => stack.append(&float_bytes(&spread).collect::<Vec<u8>>()),
            None => self.write_array(&(name + SPREAD), &spread),
        }
    }

    /// Writes the pixels of an image as `NAME.npy`, `[H, W]`.
    fn write_array(&self, name: &str, image: &Image) -> Result<()> {
        let mut npy = npy_header(Number::F32, &[image.height, image.width]);
        npy.extend(float_bytes(image));
        self.folder.put(&format!("{name}.npy"), npy)
    }

    /// Writes an image as `NAME.png`, times `gain` and clamped to [0, 1], unless images are disabled.
    fn write_png(&self, name: &str, image: &Image, gain: Real) -> Result<()> {
        if !self.has_png {
            return Ok(());
        }
        let mut png = Vec::new();
        let shown = Image { pixels: image.pixels.iter().map(|p| gain * p).collect(), ..*image };
        PngEncoder::new(&mut png)
            .write_image(&shown.to_bytes(), image.width as u32, image.height as u32, ExtendedColorType::L8)
            .map_err(|e| Error::write(self.folder.path(), std::io::Error::other(e)))?;
        self.folder.put(&format!("{name}.png"), png)
    }
}

/// Returns whether predictions have the standard deviation over the members of an ensemble.
fn has_spread(model: &Prepared<'_>) -> bool {
    model.models().count() > 1
}

/// Formats the first line of `predictions.csv`: the names of its columns, in the order in which [`PredictionRow::first_columns`],
/// [`PredictionWriter::format_prediction`] and [`PredictionRow::last_columns`] format them.
fn list_header(model: &Prepared<'_>, has_interval: bool) -> String {
    let task = model.task();
    let pose = if model.moving().is_receiver() { "x,y,z,qx,qy,qz,qw" } else { "x,y,z" };
    let columns_if = |condition: bool, columns: &'static str| if condition { columns } else { "" };
    let prediction = if task.has_pixels {
        let receiver = columns_if(model.receivers().len() > 1, "receiver,");
        let bound = columns_if(has_interval, "ssim_bound,");
        format!("{receiver}azimuth_deg,elevation_deg,peak,{bound}")
    } else if task.is_complex {
        "receiver,db,".to_owned()
    } else {
        let spread = columns_if(has_spread(model), "spread_db,");
        let interval = columns_if(has_interval, "lower_dbm,upper_dbm,");
        format!("receiver,dbm,{spread}{interval}")
    };
    let degrees = columns_if(model.setup().geodetic.is_some(), Geodetic::COLUMNS);
    format!("row,{pose},{prediction}training_distance_m{degrees}\n")
}

/// Array of all predictions, `NAME.npy`.
struct Stack {
    name: String,
    header: Vec<u8>,
    row_bytes: usize,
}

impl Stack {
    /// Returns the number of rows that a partial file has in full.
    fn complete_rows(&self, path: &Path) -> usize {
        let bytes = path.metadata().map_or(0, |metadata| metadata.len() as usize);
        bytes.saturating_sub(self.header.len()) / self.row_bytes.max(1)
    }
}

/// Returns the arrays of `count` spectra or channels: predictions, deviations, lower and upper bounds, as far as they exist.
fn stacks_of(model: &Prepared<'_>, has_interval: bool, count: usize) -> Vec<Stack> {
    let (is_complex, plane) = (model.task().is_complex, model.plane());
    let size = [count, if is_complex { plane.height / 2 } else { plane.height }, plane.width];
    let stack = |name: &str, header: Vec<u8>, bytes: usize| Stack {
        name: format!("{name}.npy"),
        header,
        row_bytes: bytes * size[1] * size[2],
    };
    let floats = npy_header(Number::F32, &size);
    let first = if is_complex {
        stack("channels", npy_header_as(COMPLEX, &size), 8)
    } else {
        stack("spectra", floats.clone(), 4)
    };
    let further = [("spread", has_spread(model)), ("lower", has_interval), ("upper", has_interval)];
    let further = further.iter().filter(|(_, is_written)| *is_written).map(|(name, _)| stack(name, floats.clone(), 4));
    std::iter::once(first).chain(further).collect()
}

/// Counts the complete lines at the start of a partial table, at most `limit`, and their bytes; 0 without the file. A quoted
/// cell may have line breaks.
fn complete_lines(path: &Path, limit: usize) -> Result<(usize, u64)> {
    let Some(file) = files::if_found(path, files::open(path))? else { return Ok((0, 0)) };
    let (mut reader, mut line) = (BufReader::new(file), Vec::new());
    let (mut lines, mut bytes, mut read, mut is_quoted) = (0, 0, 0, false);
    while lines < limit && reader.read_until(b'\n', &mut line).map_err(|e| Error::read(path, e))? > 0 {
        read += line.len() as u64;
        is_quoted = line.iter().fold(is_quoted, |is_quoted, byte| is_quoted ^ (*byte == b'"'));
        if line.ends_with(b"\n") && !is_quoted {
            (lines, bytes) = (lines + 1, read);
        }
        line.clear();
    }
    Ok((lines, bytes))
}

/// Computes the standard deviations of complex gains, `[A, F]`, from those of their real and imaginary parts, `[2 A,
/// F]`.
fn complex_deviations(parts: &Image) -> Image {
    let pixels: Vec<Real> = gains_of(&parts.pixels, parts.width).iter().map(|[re, im]| re.hypot(*im)).collect();
    Image { width: parts.width, height: parts.height / 2, pixels }
}

/// Formats the start of the file names of row `row`, from 1.
fn row_name(row: usize) -> String {
    format!("{row:05}")
}

/// Returns the bytes of the pixels as 32-bit floats.
fn float_bytes(image: &Image) -> impl Iterator<Item = u8> {
    image.pixels.iter().flat_map(|p| (*p as f32).to_le_bytes())
}

/// Returns the bytes of complex numbers with 32-bit parts.
fn complex_bytes(gains: &[[Real; 2]]) -> impl Iterator<Item = u8> {
    gains.as_flattened().iter().flat_map(|v| (*v as f32).to_le_bytes())
}
