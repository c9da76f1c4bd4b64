//! Received powers as files: NeRF2's layout of its BLE set.

use super::{Sink, list, put};
use crate::observe::{Heard, Observed, SILENT_DBM};
use crate::simulator::Simulator;
use pwrfgs_core::Result;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Readings in dBm: a row a transmitter, a column a receiver.
pub(crate) const POWERS: &str = "gateway_rssi.csv";
/// Places of the receivers.
const PLACES: &str = "gateway_position.yml";

pub(super) struct Powers {
    folder: PathBuf,
    places: String,
    rows: String,
}

impl Powers {
    pub(super) fn new(folder: &Path, simulator: &Simulator) -> Self {
        let receivers = || simulator.listeners().iter().map(crate::Listener::receiver);
        let place = |receiver: &crate::scene::Receiver| format!("{}: {}\n", receiver.name, list(&receiver.position));
        let names: Vec<&str> = receivers().map(|receiver| &*receiver.name).collect();
        Self { folder: folder.into(), places: receivers().map(place).collect(), rows: names.join(",") + "\n" }
    }
}

impl Sink for Powers {
    fn add(&mut self, _: usize, heard: &[Heard]) -> Result<()> {
        for (i, heard) in heard.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            match &heard.observed {
                Observed::Power(dbm) if *dbm > SILENT_DBM => write!(self.rows, "{comma}{dbm:.3}"),
                _ => write!(self.rows, "{comma}{SILENT_DBM:.1}"),
            }
            .expect("text grows");
        }
        self.rows.push('\n');
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        put(&self.folder.join(PLACES), self.places)?;
        put(&self.folder.join(POWERS), self.rows)
    }
}
