//! The files that every layout has: transmitters, lists of numbers, and paths.

use super::put;
use crate::observe::Heard;
use crate::path_table::PathTable;
use crate::simulator::Simulator;
use glam::DVec3;
use pwrfgs_core::{Error, Result};
use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Every path of every transmitter.
pub const PATHS: &str = "paths.csv";
pub(crate) const POSITIONS: &str = "tx_pos.csv";
const TRAIN: &str = "train_index.txt";
const TEST: &str = "test_index.txt";
/// Every how-manieth sample belongs to the test list.
const TEST_EVERY: usize = 5;

/// Whether the `i`th transmitter, counted from 0, is for testing.
pub(crate) fn is_test(i: usize) -> bool {
    (i + 1).is_multiple_of(TEST_EVERY)
}

/// How a layout of NeRF2 calls its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Numbers {
    /// 00001 and so on: names of pictures.
    FromOne,
    /// 0 and so on: rows.
    FromZero,
}

impl Numbers {
    /// The number of the `i`th sample, counted from 0.
    pub(super) fn of(self, i: usize) -> usize {
        match self {
            Self::FromOne => i + 1,
            Self::FromZero => i,
        }
    }

    fn list(self, samples: usize, test: bool) -> String {
        let mut text = String::new();
        for i in (0..samples).filter(|i| is_test(*i) == test) {
            match self {
                Self::FromOne => writeln!(text, "{:05}", i + 1),
                Self::FromZero => writeln!(text, "{i}"),
            }
            .expect("text grows");
        }
        text
    }
}

/// The tables, which grow by a transmitter at a time.
pub(super) struct Tables {
    numbers: Numbers,
    positions: String,
    /// A table a receiver, or none.
    paths: Vec<(PathTable, BufWriter<fs::File>, PathBuf)>,
}

impl Tables {
    pub(super) fn new(folder: &Path, simulator: &Simulator, numbers: Numbers, paths: bool) -> Result<Self> {
        let listeners = simulator.listeners();
        let create = |i: usize| -> Result<_> {
            let own = format!("paths-{}.csv", listeners[i].receiver().name);
            let path = folder.join(if listeners.len() == 1 { PATHS } else { &own });
            let mut file = BufWriter::new(fs::File::create(&path).map_err(|e| Error::write(&path, e))?);
            writeln!(file, "{}", PathTable::HEADER).map_err(|e| Error::write(&path, e))?;
            Ok((PathTable::new(simulator.world(), &listeners[i]), file, path))
        };
        let paths = if paths { (0..listeners.len()).map(create).collect::<Result<_>>()? } else { Vec::new() };
        Ok(Self { numbers, positions: "x,y,z\n".into(), paths })
    }

    /// Adds the `i`th transmitter, counted from 0.
    pub(super) fn add(&mut self, i: usize, tx: DVec3, heard: &[Heard]) -> Result<()> {
        writeln!(self.positions, "{},{},{}", tx.x, tx.y, tx.z).expect("text grows");
        for ((table, file, path), heard) in self.paths.iter_mut().zip(heard) {
            let rows = table.rows(self.numbers.of(i), &heard.paths);
            file.write_all(rows.as_bytes()).map_err(|e| Error::write(path, e))?;
        }
        Ok(())
    }

    pub(super) fn finish(self, folder: &Path, samples: usize) -> Result<()> {
        for (_, mut file, path) in self.paths {
            file.flush().map_err(|e| Error::write(&path, e))?;
        }
        put(&folder.join(POSITIONS), self.positions)?;
        put(&folder.join(TRAIN), self.numbers.list(samples, false))?;
        put(&folder.join(TEST), self.numbers.list(samples, true))
    }
}
