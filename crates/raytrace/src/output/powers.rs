//! Received powers as files: NeRF2's layout of its BLE set.

use super::{Sink, list, put};
use crate::observe::{Heard, Observed, SILENT_DBM};
use crate::simulator::Simulator;
use pwrfgs_core::{Error, Result, files};
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
                Observed::Power(dbm) if *dbm > SILENT_DBM => {
                    // Rounded, none is what stands for nothing received.
                    write!(self.rows, "{comma}{:.3}", dbm.max(SILENT_DBM + 1e-3))
                }
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

/// Refuses a table with transmitters that no receiver receives, or receivers that receive none: who reads the layout cannot
/// tell them from mistakes.
pub(super) fn check(folder: &Path) -> Result<()> {
    let text = files::read_string(folder.join(POWERS)).map_err(|e| Error::read(folder, e))?;
    let silent = format!("{SILENT_DBM:.1}");
    let rows = || text.lines().skip(1);
    let columns = rows().next().map_or(0, |row| row.split(',').count());
    let is_deaf = |column: &usize| rows().all(|row| row.split(',').nth(*column) == Some(&*silent));
    if let Some(column) = (0..columns).find(is_deaf) {
        let name = text.lines().next().and_then(|names| names.split(',').nth(column)).unwrap_or_default();
        return Err(Error::Config(format!(
            "receiver `{name}` receives no transmitter above {SILENT_DBM} dBm, which the layout cannot say; raise `power_dbm` \
             of the transmitter, or leave the receiver out"
        )));
    }
    match rows().filter(|row| row.split(',').all(|cell| cell == silent)).count() {
        0 => Ok(()),
        unheard => Err(Error::Config(format!(
            "{unheard} of {} transmitters are heard by no receiver above {SILENT_DBM} dBm, which the layout cannot say; raise \
             `power_dbm` of the transmitter, or keep it nearer to receivers",
            rows().count()
        ))),
    }
}
