//! Channels as files: one array of complex numbers, and what its axes are.

use super::{Sink, list, put};
use crate::listener::Listener;
use crate::observe::{Heard, Observed};
use crate::simulator::Simulator;
use crate::wave::Complex;
use pwrfgs_core::{Error, Result};
use pwrfgs_data::npy_header_as;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Channels, complex64 `[links, antennas, subcarriers]`.
pub(crate) const CHANNELS: &str = "channel.npy";
/// The same as NeRF2 calls it: the first half of the subcarriers is the uplink, the second the downlink.
const CSI: &str = "csidata.npy";
/// What the axes are.
const RECEIVER: &str = "receiver.yml";
/// Places of the antennas, as NeRF2 has them.
const STATION: &str = "base-station.yml";

pub(super) struct Channels {
    array: BufWriter<fs::File>,
    path: PathBuf,
    /// A further file and its text.
    facts: Option<(PathBuf, String)>,
}

impl Channels {
    /// `links` is the length of the array.
    pub(super) fn new(folder: &Path, simulator: &Simulator, samples: usize) -> Result<Self> {
        let listeners = simulator.listeners();
        let facts = |listener| (folder.join(RECEIVER), receiver_yaml(simulator, listener));
        let facts = (listeners.len() == 1).then(|| facts(&listeners[0]));
        Self::begin(folder.join(CHANNELS), simulator, samples, facts)
    }

    /// In NeRF2's layout.
    pub(super) fn csi(folder: &Path, simulator: &Simulator, samples: usize) -> Result<Self> {
        let antennas = antennas(&simulator.listeners()[0]);
        let facts = (folder.join(STATION), format!("base_station: [{antennas}]\n"));
        Self::begin(folder.join(CSI), simulator, samples, Some(facts))
    }

    fn begin(path: PathBuf, simulator: &Simulator, samples: usize, facts: Option<(PathBuf, String)>) -> Result<Self> {
        let (listeners, subcarriers) = (simulator.listeners(), simulator.scene().frequencies().len());
        let antennas = listeners[0].receiver().array.elements();
        let header = npy_header_as("<c8", &[samples * listeners.len(), antennas, subcarriers]);
        let begun = fs::File::create(&path).and_then(|file| {
            let mut file = BufWriter::with_capacity(1 << 20, file);
            file.write_all(&header).map(|()| file)
        });
        Ok(Self { array: begun.map_err(|e| Error::write(&path, e))?, path, facts })
    }
}

impl Sink for Channels {
    fn add(&mut self, _: usize, heard: &[Heard]) -> Result<()> {
        for heard in heard {
            let Observed::Channel(channel) = &heard.observed else { continue };
            let bytes = |h: &Complex| [(h.re as f32).to_le_bytes(), (h.im as f32).to_le_bytes()];
            let bytes: Vec<u8> = channel.iter().flat_map(bytes).flatten().collect();
            self.array.write_all(&bytes).map_err(|e| Error::write(&self.path, e))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.array.flush().map_err(|e| Error::write(&self.path, e))?;
        self.facts.map_or(Ok(()), |(path, text)| put(&path, text))
    }
}

/// What the axes of the array are: YAML.
fn receiver_yaml(simulator: &Simulator, listener: &Listener) -> String {
    let (scene, pose) = (simulator.scene(), listener.pose());
    let spacing = scene.subcarriers.as_ref().map_or(0.0, |band| band.spacing_hz());
    format!(
        "name: {}\nposition: {}\norientation: {} # quaternion x, y, z, w\ncarrier_hz: {:?}\nspacing_hz: {spacing:?}\n\
         frequencies_hz: {}\nantennas: [{}] # in the world, metres\n",
        listener.receiver().name,
        list(&pose.position),
        list(&pose.orientation),
        scene.carrier_hz,
        list(&scene.frequencies()),
        antennas(listener)
    )
}

fn antennas(listener: &Listener) -> String {
    listener.antennas().iter().map(|place| list(&place.to_array())).collect::<Vec<_>>().join(", ")
}
