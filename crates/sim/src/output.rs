//! A simulated data set as a folder: the layout of NeRF2, and what only a simulation knows.

use crate::path_table::PathTable;
use crate::recipe::Recipe;
use crate::simulator::{HEIGHT, Reception, Simulator, WIDTH, simulate_until};
use crate::surface_points;
use glam::DVec3;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs_core::{Error, Number, Progress, Result, files::NewFolder, files::refuse_occupied};
use pwrfgs_data::{gateway_yaml, npy_header};
use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Everything about how the folder was made; written last, so that a folder without it is not whole.
pub const MANIFEST: &str = "manifest.json";
/// The point cloud.
pub const POINTS: &str = "points.ply";
/// Every path of every transmitter.
pub const PATHS: &str = "paths.csv";
/// Absolute power of every spectrum.
pub const POWER: &str = "power.csv";
/// The folder of the pictures.
pub(crate) const PICTURES: &str = "spectrum";
/// The array of all spectra.
const SPECTRA: &str = "spectra.npy";
const GATEWAY: &str = "gateway_info.yml";
const POSITIONS: &str = "tx_pos.csv";
const TRAIN: &str = "train_index.txt";
const TEST: &str = "test_index.txt";
/// Most pictures: their names have five digits.
const MOST_PICTURES: usize = 99_999;
/// Every how-manieth sample belongs to the test list.
const TEST_EVERY: usize = 5;

/// How spectra are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// A picture each, as NeRF2 has them.
    Png,
    /// One array, `spectra.npy`: however many there are, memory need not hold them.
    Npy,
}

/// Simulates `recipe` into the new folder `out`, a picture each spectrum.
///
/// # Errors
/// As [`write_as`].
pub fn write(recipe: &Recipe, paths: bool, out: &Path, progress: Progress<'_>) -> Result<()> {
    write_as(recipe, Pictures::Png, paths, out, progress, &AtomicBool::new(false))
}

/// Simulates `recipe` into the new folder `out`.
///
/// ```text
/// out/gateway_info.yml      pose of the receiver; the name of the data set says «simulated»
/// out/tx_pos.csv            x,y,z; row k is the transmitter of id k
/// out/spectrum/00001.png    8-bit grey, 360x90; or
/// out/spectra.npy           all of them, 8-bit grey [M, 90, 360]
/// out/train_index.txt, test_index.txt    every fifth id is a test id
/// out/power.csv             id, path gain in dB (mean over the antennas), lowest and highest value of the spectrum
/// out/paths.csv             a row each path, with `paths`
/// out/points.ply            points on all surfaces, with normals
/// out/manifest.json         the recipe
/// ```
///
/// It is made beside `out` under another name and renamed at the end, so that `out` is whole or not there; what a killed
/// process left of an earlier attempt is removed. `progress` counts spectra.
///
/// # Errors
/// `out` holds something, the disk refuses, there are more pictures than names of five digits, or `stop` is set
/// ([`Error::Stopped`]; nothing is left behind).
pub fn write_as(
    recipe: &Recipe,
    pictures: Pictures,
    paths: bool,
    out: &Path,
    progress: Progress<'_>,
    stop: &AtomicBool,
) -> Result<()> {
    if pictures == Pictures::Png && recipe.samples > MOST_PICTURES {
        return Err(Error::Config(format!(
            "{} spectra are more than the {MOST_PICTURES} pictures that have a name; write one array, with --npy",
            recipe.samples
        )));
    }
    refuse_occupied(out)?; // before the scene is looked at
    let simulator = Simulator::new(&recipe.scene)?;
    let making = NewFolder::begin(out)?;
    let folder = making.path();
    let mut spectra = Sink::new(folder, pictures, recipe.samples)?;
    let mut tables = Tables::new(folder, &simulator, paths)?;
    let go_on = || if stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) };
    simulate_until(&simulator, recipe.samples, recipe.seed, stop, |i, tx, reception| {
        go_on()?;
        spectra.add(i + 1, &reception.spectrum.pixels)?;
        tables.add(i + 1, tx, &reception)?;
        progress(i + 1, recipe.samples);
        Ok(())
    })?;
    spectra.finish()?;
    tables.finish(folder, recipe.samples)?;
    put(&folder.join(GATEWAY), gateway_yaml(&format!("{} (simulated)", recipe.scene.name), &recipe.scene.pose()))?;
    let cloud = simulator.surface_points(recipe.points, recipe.seed);
    go_on()?;
    let comment = format!("simulated by pwrfgs: surfaces of {}", recipe.scene.name);
    let path = folder.join(POINTS);
    let written = fs::File::create(&path).and_then(|file| {
        let mut file = BufWriter::new(file);
        surface_points::write_ply(&cloud, &comment, &mut file)?;
        file.flush()
    });
    written.map_err(|e| Error::write(&path, e))?;
    put(&folder.join(MANIFEST), recipe.to_json())?;
    go_on()?;
    making.publish()
}

fn put(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    fs::write(path, bytes).map_err(|e| Error::write(path, e))
}

/// Where spectra go.
enum Sink {
    Png(PathBuf),
    Npy(BufWriter<fs::File>, PathBuf),
}

impl Sink {
    fn new(folder: &Path, pictures: Pictures, count: usize) -> Result<Self> {
        match pictures {
            Pictures::Png => {
                let path = folder.join(PICTURES);
                fs::create_dir(&path).map_err(|e| Error::write(&path, e))?;
                Ok(Self::Png(path))
            }
            Pictures::Npy => {
                let path = folder.join(SPECTRA);
                let header = npy_header(Number::U8, &[count, HEIGHT, WIDTH]);
                let begun = fs::File::create(&path).and_then(|file| {
                    let mut file = BufWriter::with_capacity(1 << 20, file);
                    file.write_all(&header).map(|()| file)
                });
                Ok(Self::Npy(begun.map_err(|e| Error::write(&path, e))?, path))
            }
        }
    }

    fn add(&mut self, id: usize, pixels: &[u8]) -> Result<()> {
        match self {
            Self::Png(folder) => write_png(&folder.join(format!("{id:05}.png")), pixels),
            Self::Npy(file, path) => file.write_all(pixels).map_err(|e| Error::write(path, e)),
        }
    }

    fn finish(self) -> Result<()> {
        match self {
            Self::Png(_) => Ok(()),
            Self::Npy(mut file, path) => file.flush().map_err(|e| Error::write(&path, e)),
        }
    }
}

fn write_png(path: &Path, pixels: &[u8]) -> Result<()> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(pixels, WIDTH as u32, HEIGHT as u32, ExtendedColorType::L8)
        .map_err(|e| Error::write(path, std::io::Error::other(e)))?;
    put(path, bytes)
}

/// The tables, which grow by a transmitter at a time.
struct Tables {
    positions: String,
    power: String,
    paths: Option<(PathTable, BufWriter<fs::File>, PathBuf)>,
}

impl Tables {
    fn new(folder: &Path, simulator: &Simulator, paths: bool) -> Result<Self> {
        let create = || -> Result<_> {
            let path = folder.join(PATHS);
            let mut file = BufWriter::new(fs::File::create(&path).map_err(|e| Error::write(&path, e))?);
            writeln!(file, "{}", PathTable::HEADER).map_err(|e| Error::write(&path, e))?;
            Ok((PathTable::new(simulator), file, path))
        };
        let paths = paths.then(create).transpose()?;
        Ok(Self { positions: "x,y,z\n".into(), power: "id,path_gain_db,low,high\n".into(), paths })
    }

    fn add(&mut self, id: usize, tx: DVec3, reception: &Reception) -> Result<()> {
        let spectrum = &reception.spectrum;
        let decibel = 10.0 * spectrum.power.log10();
        writeln!(self.positions, "{},{},{}", tx.x, tx.y, tx.z).expect("text grows");
        writeln!(self.power, "{id},{decibel:.4},{:.6e},{:.6e}", spectrum.low, spectrum.high).expect("text grows");
        if let Some((table, file, path)) = &mut self.paths {
            file.write_all(table.rows(id, &reception.paths).as_bytes()).map_err(|e| Error::write(path, e))?;
        }
        Ok(())
    }

    fn finish(self, folder: &Path, samples: usize) -> Result<()> {
        if let Some((_, mut file, path)) = self.paths {
            file.flush().map_err(|e| Error::write(&path, e))?;
        }
        put(&folder.join(POSITIONS), self.positions)?;
        put(&folder.join(POWER), self.power)?;
        let list = |test: bool| {
            let ids = (1..=samples).filter(|id| id.is_multiple_of(TEST_EVERY) == test);
            ids.fold(String::new(), |mut text, id| {
                writeln!(text, "{id:05}").expect("text grows");
                text
            })
        };
        put(&folder.join(TRAIN), list(false))?;
        put(&folder.join(TEST), list(true))
    }
}
