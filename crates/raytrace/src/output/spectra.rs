//! Spectra as files: a picture each, or one array of all.

use super::{Sink, put};
use crate::observe::{Heard, Observed};
use crate::simulator::{HEIGHT, Simulator, WIDTH};
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs_core::{Error, Number, Result};
use pwrfgs_data::{gateway_yaml, npy_header};
use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Absolute power of every spectrum.
pub const POWER: &str = "power.csv";
/// The folder of the pictures.
pub(crate) const PICTURES: &str = "spectrum";
/// The array of all spectra.
pub(crate) const SPECTRA: &str = "spectra.npy";
const GATEWAY: &str = "gateway_info.yml";

/// Where spectra go; with several receivers, those of a transmitter one after the other.
pub(super) struct Spectra {
    folder: PathBuf,
    /// Of one receiver; several have places of their own elsewhere.
    gateway: Option<String>,
    pictures: Pictures,
    power: String,
}

enum Pictures {
    Png(PathBuf),
    Npy(BufWriter<fs::File>, PathBuf),
}

impl Spectra {
    pub(super) fn new(folder: &Path, simulator: &Simulator, png: bool, samples: usize) -> Result<Self> {
        let receivers = simulator.listeners().len();
        let pictures = if png { Pictures::png(folder) } else { Pictures::npy(folder, samples * receivers) };
        let name = format!("{} (simulated)", simulator.scene().name);
        let gateway = (receivers == 1).then(|| gateway_yaml(&name, &simulator.scene().pose()));
        Ok(Self { folder: folder.into(), gateway, pictures: pictures?, power: "id,path_gain_db,low,high\n".into() })
    }
}

impl Sink for Spectra {
    fn add(&mut self, i: usize, heard: &[Heard]) -> Result<()> {
        for heard in heard {
            let Observed::Spectrum(spectrum) = &heard.observed else { continue };
            let (id, decibel) = (i + 1, 10.0 * spectrum.power.log10());
            self.pictures.add(id, &spectrum.pixels)?;
            writeln!(self.power, "{id},{decibel:.4},{:.6e},{:.6e}", spectrum.low, spectrum.high).expect("text grows");
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.pictures.finish()?;
        let Some(gateway) = self.gateway else { return Ok(()) };
        put(&self.folder.join(GATEWAY), gateway)?;
        put(&self.folder.join(POWER), self.power)
    }
}

impl Pictures {
    fn png(folder: &Path) -> Result<Self> {
        let path = folder.join(PICTURES);
        fs::create_dir(&path).map_err(|e| Error::write(&path, e))?;
        Ok(Self::Png(path))
    }

    fn npy(folder: &Path, count: usize) -> Result<Self> {
        let path = folder.join(SPECTRA);
        let header = npy_header(Number::U8, &[count, HEIGHT, WIDTH]);
        let begun = fs::File::create(&path).and_then(|file| {
            let mut file = BufWriter::with_capacity(1 << 20, file);
            file.write_all(&header).map(|()| file)
        });
        Ok(Self::Npy(begun.map_err(|e| Error::write(&path, e))?, path))
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
