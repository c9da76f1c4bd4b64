//! Received powers as files: NeRF2's layout of its BLE set.

use super::{Sink, list, put};
use crate::observe::{Heard, Observed, SILENT_DBM};
use crate::simulator::Simulator;
use pwrfgs_core::{Error, Result};
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
    transmitters: usize,
    /// Those that no receiver hears.
    unheard: usize,
}

impl Powers {
    pub(super) fn new(folder: &Path, simulator: &Simulator) -> Self {
        let receivers = || simulator.listeners().iter().map(crate::Listener::receiver);
        let place = |receiver: &crate::scene::Receiver| format!("{}: {}\n", receiver.name, list(&receiver.position));
        let names: Vec<&str> = receivers().map(|receiver| &*receiver.name).collect();
        let (places, rows) = (receivers().map(place).collect(), names.join(",") + "\n");
        Self { folder: folder.into(), places, rows, transmitters: 0, unheard: 0 }
    }
}

impl Sink for Powers {
    fn add(&mut self, _: usize, heard: &[Heard]) -> Result<()> {
        self.transmitters += 1;
        let silent = |heard: &Heard| !matches!(&heard.observed, Observed::Power(dbm) if *dbm > SILENT_DBM);
        self.unheard += usize::from(heard.iter().all(silent));
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
        if self.unheard > 0 {
            return Err(Error::Config(format!(
                "{} of {} transmitters are heard by no receiver above {SILENT_DBM} dBm, which the layout cannot say; raise \
                 `power_dbm`, or keep transmitters nearer to receivers",
                self.unheard, self.transmitters
            )));
        }
        put(&self.folder.join(PLACES), self.places)?;
        put(&self.folder.join(POWERS), self.rows)
    }
}
