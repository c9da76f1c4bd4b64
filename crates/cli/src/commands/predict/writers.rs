//! Output files of predictions: arrays, images and the lines of `predictions.csv`.

use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs::data::{npy_header, npy_header_as};
use pwrfgs::experiment::text::field;
use pwrfgs::model::{Interval, Prepared};
use pwrfgs_core::files::{GrowingFile, NewFolder};
use pwrfgs_core::{End, Error, Image, ImagePlane, Number, Pose, Real, Result, Task, gains_of};
use rayon::prelude::*;
use std::fmt::Write as _;

/// NumPy type of pairs of 32-bit floats.
const COMPLEX: &str = "<c8";
/// Suffix of files with the standard deviation of an ensemble.
const SPREAD: &str = "-spread";

/// Row of `predictions.csv`: pose of the moving end, and receiver.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictionRow<'a> {
    /// Number of the row, from 1.
    pub(super) number: usize,
    /// Pose of the moving end.
    pub(super) pose: Pose,
    /// Whether the row has the orientation, of a moving receiver.
    pub(super) has_orientation: bool,
    pub(super) receiver: usize,
    /// Name of the receiver; none for spectra at a single receiver.
    pub(super) name: Option<&'a str>,
    /// Distance to the nearest training position, metres; none if unknown.
    pub(super) training_distance: Option<f64>,
}

/// Name of the last column of `predictions.csv`.
const DISTANCE: &str = "training_distance_m";

/// Returns the names of the columns of the positions of a transmitter or the poses of a receiver.
fn pose_columns(moving: End) -> &'static str {
    if moving.is_receiver() { "x,y,z,qx,qy,qz,qw" } else { "x,y,z" }
}

impl PredictionRow<'_> {
    /// Formats the first columns of the row.
    fn start(&self) -> String {
        let (Pose { position: [x, y, z], orientation }, number) = (self.pose, self.number);
        let name = self.name.map_or_else(String::new, |name| format!(",{}", field(name)));
        let turn = if self.has_orientation { orientation.map(|v| format!(",{v}")).concat() } else { String::new() };
        format!("{number},{x},{y},{z}{turn}{name}")
    }

    /// Formats the last columns of the row.
    fn end(&self, milliseconds: f64) -> String {
        let distance = self.training_distance.map_or_else(String::new, |metres| format!("{metres:.3}"));
        format!("{milliseconds:.3},{distance}\n")
    }
}

/// Prediction of one row.
pub(super) struct PredictionImage {
    pub(super) image: Image,
    /// Standard deviation over the members of an ensemble.
    pub(super) spread: Option<Image>,
    pub(super) interval: Option<Interval>,
    pub(super) milliseconds: f64,
}

/// Row with its prediction.
pub(super) type PredictedRow<'a> = (PredictionRow<'a>, PredictionImage);

/// Writer of predictions of one task.
pub(super) trait Writer {
    /// Returns the first line of `predictions.csv`.
    fn header(&self) -> String;

    /// Writes the next rows and adds their lines to the list.
    fn write(&mut self, folder: &OutputFolder<'_>, rows: &[PredictedRow<'_>], list: &mut String) -> Result<()>;

    /// Completes all files except the list.
    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

/// Creates the writer for `count` predictions of `model`, with intervals if `has_interval`.
pub(super) fn writer<'a>(
    folder: &OutputFolder<'_>,
    model: &Prepared<'a>,
    count: usize,
    has_interval: bool,
) -> Result<Box<dyn Writer + 'a>> {
    let task = model.task();
    Ok(if task.has_pixels {
        Box::new(Spectra::begin(folder, model, count, has_interval)?)
    } else if task.is_complex {
        Box::new(Channels::begin(folder, model, count)?)
    } else {
        Box::new(Powers { moving: model.moving(), has_spread: model.models().count() > 1, has_interval })
    })
}

/// Writer of spectra.
struct Spectra<'a> {
    plane: &'a ImagePlane,
    has_names: bool,
    moving: End,
    has_interval: bool,
    stacks: Vec<GrowingFile>,
}

impl<'a> Spectra<'a> {
    /// Creates the writer, with files of all predictions if they are stacked.
    fn begin(folder: &OutputFolder<'_>, model: &Prepared<'a>, count: usize, has_interval: bool) -> Result<Self> {
        let plane = model.plane();
        let size = [count, plane.height, plane.width];
        let has_spread = model.models().count() > 1;
        let names = [("spectra", true), ("spread", has_spread), ("lower", has_interval), ("upper", has_interval)];
        let stack = |(name, _)| folder.stack(&format!("{name}.npy"), &npy_header(Number::F32, &size));
        let stacks = names.into_iter().filter(|(_, is_written)| folder.stacked && *is_written).map(stack);
        let stacks = stacks.collect::<Result<_>>()?;
        Ok(Self { plane, has_names: model.receivers().len() > 1, moving: model.moving(), has_interval, stacks })
    }
}

impl Writer for Spectra<'_> {
    fn header(&self) -> String {
        let receiver = if self.has_names { "receiver," } else { "" };
        let bound = if self.has_interval { "ssim_bound," } else { "" };
        let pose = pose_columns(self.moving);
        format!("row,{pose},{receiver}azimuth_deg,elevation_deg,peak,{bound}milliseconds,{DISTANCE}\n")
    }

    fn write(&mut self, folder: &OutputFolder<'_>, rows: &[PredictedRow<'_>], list: &mut String) -> Result<()> {
        let images: Vec<&Image> = rows.iter().map(|(_, drawn)| &drawn.image).collect();
        let spreads: Vec<&Image> = rows.iter().filter_map(|(_, drawn)| drawn.spread.as_ref()).collect();
        let intervals = || rows.iter().filter_map(|(_, drawn)| drawn.interval.as_ref());
        let (lower, upper) = intervals().map(|interval| (&interval.lower, &interval.upper)).unzip();
        let kinds = [("", 1.0, images), (SPREAD, 2.0, spreads), ("-lower", 1.0, lower), ("-upper", 1.0, upper)];
        for (k, (suffix, gain, images)) in kinds.iter().filter(|(.., images)| !images.is_empty()).enumerate() {
            let write_image = |(image, (row, _)): (&&Image, &PredictedRow<'_>)| {
                let name = file_name(row.number) + suffix;
                if self.stacks.is_empty() {
                    folder.array(&name, image)?;
                }
                folder.picture(&name, image, *gain as Real)
            };
            images.par_iter().zip(rows).map(write_image).collect::<Result<Vec<()>>>()?;
            if let Some(stack) = self.stacks.get_mut(k) {
                images.iter().try_for_each(|image| stack.append(&float_bytes(image).collect::<Vec<u8>>()))?;
            }
        }
        list.extend(rows.iter().map(|(row, drawn)| spectrum_line(self.plane, row, drawn)));
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.stacks.into_iter().try_for_each(GrowingFile::finish)
    }
}

/// Formats the line of a spectrum in `predictions.csv`; without angles if the image plane has none.
fn spectrum_line(plane: &ImagePlane, row: &PredictionRow<'_>, drawn: &PredictionImage) -> String {
    let image = &drawn.image;
    let strongest = image.argmax();
    let (column, line) = ((strongest % image.width) as Real, (strongest / image.width) as Real);
    let angles = plane.azimuth_elevation_deg(column, line);
    let angles = angles.map_or_else(|| ",".into(), |(az, el)| format!("{az},{el}"));
    let bound = drawn.interval.as_ref().and_then(|interval| interval.ssim);
    let bound = bound.map_or_else(String::new, |bound| format!("{bound:.4},"));
    format!("{},{angles},{},{bound}{}", row.start(), image.pixels[strongest], row.end(drawn.milliseconds))
}

/// Writer of received powers.
struct Powers {
    moving: End,
    /// Whether there is a column with the standard deviation of an ensemble.
    has_spread: bool,
    /// Whether there are columns with the ends of an interval.
    has_interval: bool,
}

impl Writer for Powers {
    fn header(&self) -> String {
        let spread = if self.has_spread { "spread_db," } else { "" };
        let interval = if self.has_interval { "lower_dbm,upper_dbm," } else { "" };
        let pose = pose_columns(self.moving);
        format!("row,{pose},receiver,dbm,{spread}{interval}ms,{DISTANCE}\n")
    }

    fn write(&mut self, _: &OutputFolder<'_>, rows: &[PredictedRow<'_>], list: &mut String) -> Result<()> {
        for (row, PredictionImage { image, spread, interval, milliseconds }) in rows {
            let ends = interval.iter().flat_map(|interval| [&interval.lower, &interval.upper]);
            _ = write!(list, "{},", row.start());
            for value in std::iter::once(image).chain(spread).chain(ends) {
                _ = write!(list, "{},", value.pixels[0]);
            }
            *list += &row.end(*milliseconds);
        }
        Ok(())
    }
}

/// Writer of channels.
struct Channels {
    task: Task,
    moving: End,
    stacks: Vec<GrowingFile>,
}

impl Channels {
    /// Creates the writer, with files of all predictions if they are stacked.
    fn begin(folder: &OutputFolder<'_>, model: &Prepared<'_>, count: usize) -> Result<Self> {
        let size = [count, model.plane().height / 2, model.plane().width];
        let mut stacks = Vec::new();
        if folder.stacked {
            stacks.push(folder.stack("channels.npy", &npy_header_as(COMPLEX, &size))?);
            if model.models().count() > 1 {
                stacks.push(folder.stack("spread.npy", &npy_header(Number::F32, &size))?);
            }
        }
        Ok(Self { task: model.task(), moving: model.moving(), stacks })
    }
}

impl Writer for Channels {
    fn header(&self) -> String {
        format!("row,{},receiver,db,ms,{DISTANCE}\n", pose_columns(self.moving))
    }

    fn write(&mut self, folder: &OutputFolder<'_>, rows: &[PredictedRow<'_>], list: &mut String) -> Result<()> {
        for (row, PredictionImage { image, spread, milliseconds, .. }) in rows {
            let (gains, name) = (gains_of(&image.pixels, image.width), file_name(row.number));
            let spread = spread.as_ref().map(complex_deviations);
            if let Some(stack) = self.stacks.first_mut() {
                stack.append(&complex_bytes(&gains).collect::<Vec<u8>>())?;
            } else {
                folder.gains(&name, [image.height / 2, image.width], &gains)?;
            }
            match (self.stacks.get_mut(1), &spread) {
                (Some(stack), Some(spread)) => stack.append(&float_bytes(spread).collect::<Vec<u8>>())?,
                (None, Some(spread)) => folder.array(&(name + SPREAD), spread)?,
                _ => {}
            }
            _ = write!(list, "{},{:.4},{}", row.start(), self.task.level(image), row.end(*milliseconds));
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.stacks.into_iter().try_for_each(GrowingFile::finish)
    }
}

/// Computes the standard deviations of complex gains, from those of their real and imaginary parts.
fn complex_deviations(parts: &Image) -> Image {
    let pixels: Vec<Real> = gains_of(&parts.pixels, parts.width).iter().map(|[re, im]| re.hypot(*im)).collect();
    Image { width: parts.width, height: parts.height / 2, pixels }
}

/// Output folder.
pub(super) struct OutputFolder<'a> {
    pub(super) folder: &'a NewFolder,
    pub(super) has_png: bool,
    /// Whether all spectra or channels are one array.
    pub(super) stacked: bool,
}

impl OutputFolder<'_> {
    /// Writes `NAME.npy`.
    fn array(&self, name: &str, image: &Image) -> Result<()> {
        let mut npy = npy_header(Number::F32, &[image.height, image.width]);
        npy.extend(float_bytes(image));
        self.put(&format!("{name}.npy"), &npy)
    }

    /// Writes complex gains as `NAME.npy`, `[A, F]`.
    fn gains(&self, name: &str, shape: [usize; 2], gains: &[[Real; 2]]) -> Result<()> {
        let mut npy = npy_header_as(COMPLEX, &shape);
        npy.extend(complex_bytes(gains));
        self.put(&format!("{name}.npy"), &npy)
    }

    /// Writes `NAME.png` (times `gain`, clamped to [0, 1]), unless images are disabled.
    fn picture(&self, name: &str, image: &Image, gain: Real) -> Result<()> {
        if !self.has_png {
            return Ok(());
        }
        let mut png = Vec::new();
        let shown = Image { pixels: image.pixels.iter().map(|p| gain * p).collect(), ..*image };
        PngEncoder::new(&mut png)
            .write_image(&shown.to_bytes(), image.width as u32, image.height as u32, ExtendedColorType::L8)
            .map_err(|e| Error::write(self.folder.path(), std::io::Error::other(e)))?;
        self.put(&format!("{name}.png"), &png)
    }

    /// Writes a file.
    pub(super) fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        self.folder.put(name, bytes)
    }

    /// Creates an array that is written row by row.
    fn stack(&self, name: &str, header: &[u8]) -> Result<GrowingFile> {
        GrowingFile::create(self.folder.path().join(name), header)
    }
}

/// Returns the start of the file names of a row, from 1.
fn file_name(row: usize) -> String {
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
