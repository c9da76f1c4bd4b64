//! A folder that the cache keeps, read back: all links, the receivers of a transmitter one after the other.
//!
//! Only what this very program wrote is read here: anything else is damage, and the cache makes it anew.

#[cfg(test)]
mod tests;

use crate::observe::Observe;
use crate::output::{CHANNELS, POSITIONS, POWERS, SPECTRA};
use crate::recipe::Recipe;
use crate::simulator::{HEIGHT, WIDTH};
use pwrfgs_core::{Error, Number, Result, Spectra, files};
use pwrfgs_data::{npy_header, npy_header_as};
use std::path::Path;

/// Most bytes of spectra that memory holds; more stay in the file.
const IN_MEMORY: u64 = 512 << 20;

/// What a recipe gives: link `transmitter * receivers + receiver` is that of this pair.
#[derive(Debug)]
pub struct Kept {
    /// Transmitters `[M, 3]`, metres.
    pub transmitters: Vec<[f64; 3]>,
    /// What was observed of every link.
    pub values: Values,
}

/// What was observed of every link.
#[derive(Debug)]
pub enum Values {
    /// Pictures `[links, 90, 360]`.
    Spectra(Spectra),
    /// Readings `[links]` in dBm; what was not heard is [`SILENT_DBM`](crate::SILENT_DBM).
    Powers(Vec<f64>),
    /// Channels `[links, antennas, subcarriers]`, real and imaginary part.
    Channels(Vec<[f32; 2]>),
}

impl Kept {
    /// Reads the folder of `recipe`, as [`cache::open_or_make`](crate::cache::open_or_make) hands it over.
    ///
    /// # Errors
    /// It does not hold what the recipe gives.
    pub fn read(recipe: &Recipe, folder: &Path) -> Result<Self> {
        let (scene, samples) = (&recipe.scene, recipe.samples);
        let receivers = scene.receivers().count();
        let values = match recipe.observe {
            Observe::Spectrum => Values::Spectra(spectra(&folder.join(SPECTRA), samples * receivers)?),
            Observe::Power { .. } => Values::Powers(table(&folder.join(POWERS), samples, receivers)?),
            Observe::Channel { .. } => {
                let shape = [samples * receivers, scene.receiver.array.elements(), scene.frequencies().len()];
                Values::Channels(channels(&folder.join(CHANNELS), shape)?)
            }
        };
        let places = table(&folder.join(POSITIONS), samples, 3)?;
        Ok(Self { transmitters: places.as_chunks().0.to_vec(), values })
    }
}

fn spectra(path: &Path, links: usize) -> Result<Spectra> {
    let shape = [links, HEIGHT, WIDTH];
    let spectra = Spectra::open(path, npy_header(Number::U8, &shape).len() as u64, Number::U8, shape)?;
    if (links * HEIGHT * WIDTH) as u64 <= IN_MEMORY { spectra.into_memory() } else { Ok(spectra) }
}

fn channels(path: &Path, shape: [usize; 3]) -> Result<Vec<[f32; 2]>> {
    let header = npy_header_as("<c8", &shape);
    let length = header.len() + 8 * shape.iter().product::<usize>();
    let bytes = files::read_at_most(path, length as u64).map_err(|e| Error::read(path, e))?;
    match bytes.strip_prefix(&*header) {
        Some(numbers) if bytes.len() == length => {
            let parts = numbers.as_chunks().0.as_chunks().0.iter();
            Ok(parts.map(|[re, im]| [f32::from_le_bytes(*re), f32::from_le_bytes(*im)]).collect())
        }
        _ => Err(Error::input(path, "holds other channels than were simulated")),
    }
}

/// The numbers `[rows, columns]` of a table with a header.
fn table(path: &Path, rows: usize, columns: usize) -> Result<Vec<f64>> {
    let text = files::read_text(path)?;
    let cells = text.lines().skip(1).flat_map(|row| row.split(','));
    let numbers = cells.map(|cell| cell.parse::<f64>().ok().filter(|v| v.is_finite())).collect::<Option<Vec<_>>>();
    // The last number of a file that is cut short may still be one.
    let whole = numbers.filter(|numbers| numbers.len() == rows * columns && text.ends_with('\n'));
    whole.ok_or_else(|| Error::input(path, "holds another table than was simulated"))
}
