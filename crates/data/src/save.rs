//! Writes a data set in memory to a folder.

#[cfg(test)]
mod tests;

use crate::checks::{NOT_RECEIVED, check_dataset};
use crate::folder::{
    CARRIERS, IDS, POINTS, RELATIVE, format_lines, gateway_positions_yaml, gateway_yaml, quote_yaml, receiver_yaml,
    transmitter_yaml,
};
use crate::nerf2::POSES;
use crate::npy::MOST_POSITIONS;
use crate::text::MAX_YAML;
use crate::{Arrays, Channels, Nerf2Rssi};
use crate::{npy_header, npy_header_as};
use pwrfgs_core::files::{self, GrowingFile, MAX_NUMBERS, MAX_TEXT, NewFolder};
use pwrfgs_core::messages::cell;
use pwrfgs_core::{
    DataSource, Dataset, Elevation, End, Error, Number, Observations, Pose, Real, Receiver, Result, Spectra,
};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Writes the new folder `out`, complete or not at all, and returns its source: [`Arrays`] for spectra, [`Nerf2Rssi`]
/// for powers, [`Channels`] for channels. Other programs read the same files without the IDs (`ids.txt`).
///
/// # Errors
/// The layout cannot hold the data, `out` is not empty, or a write failed.
pub fn save(data: &Dataset, out: &Path) -> Result<Box<dyn DataSource>> {
    if data.features.is_some() || !data.placed {
        return refuse("no layout holds transmitters without positions; keep the original files");
    }
    if data.camera().is_some() {
        return refuse("no layout holds images of a camera; keep the original files");
    }
    check_dataset(data)?;
    let folder = NewFolder::begin(out)?;
    let writer = FolderWriter { path: folder.path(), data };
    let points = writer.write_points()?.map(|name| out.join(name));
    let source: Box<dyn DataSource> = match &data.observations {
        Observations::Spectra(spectra) => {
            writer.write_spectra(spectra)?;
            Box::new(Arrays { root: out.into(), points, ..Arrays::default() })
        }
        Observations::Powers(powers) => {
            writer.write_powers(powers)?;
            Box::new(Nerf2Rssi { root: out.into(), points })
        }
        Observations::Channels(channels) => {
            writer.write_channels(channels)?;
            Box::new(Channels { root: out.into(), points, ..Channels::default() })
        }
    };
    writer.write_ids()?;
    writer.write_manifest()?;
    writer.write_index_files()?;
    folder.publish()?;
    Ok(source)
}

/// Returns an error for data that a folder cannot hold.
fn refuse<T>(problem: &str) -> Result<T> {
    Err(Error::Config(format!("save: {problem}")))
}

/// Returns whether no power equals [`NOT_RECEIVED`], the mark of a missing link.
fn is_code_free(powers: &[Real]) -> bool {
    powers.iter().all(|dbm| *dbm as f64 != NOT_RECEIVED)
}

/// Returns a name as a cell of a CSV table, quoted unless it is ASCII without commas.
fn csv_cell(name: &str) -> String {
    let (is_plain, name) = (name.chars().all(|c| c.is_ascii() && c != ','), cell(name));
    if is_plain { name.into_owned() } else { format!("\"{name}\"") }
}

/// Returns the table of the poses of a moving receiver, as [`POSES`].
pub fn poses_csv(poses: impl Iterator<Item = Pose>) -> String {
    std::iter::once("x,y,z,qx,qy,qz,qw\n".into()).chain(poses.map(pose_row)).collect()
}

/// Returns a row of [`poses_csv`], in the order of its header: metres and a unit quaternion.
pub fn pose_row(Pose { position: [x, y, z], orientation: [qx, qy, qz, qw] }: Pose) -> String {
    format!("{x:?},{y:?},{z:?},{qx:?},{qy:?},{qz:?},{qw:?}\n")
}

/// Output folder and the data set to write.
struct FolderWriter<'a> {
    path: &'a Path,
    data: &'a Dataset,
}

impl FolderWriter<'_> {
    /// Writes a file into the folder. Returns an error if it exceeds the size limit of its reader.
    fn write_file(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        let (path, length) = (self.path.join(name), bytes.as_ref().len() as u64);
        let limit = match path.extension().and_then(|extension| extension.to_str()) {
            Some("yml") => MAX_YAML.into(),
            Some("npy") => MAX_NUMBERS,
            _ => MAX_TEXT,
        };
        if let Err(problem) = limit.check(length) {
            return refuse(&format!("{name} would have {length} bytes, but its reader {problem}"));
        }
        files::write(&path, bytes)
    }

    /// Writes the table `name` of positions, metres. Returns the errors of [`Self::write_file`].
    fn write_positions(&self, name: &str, rows: impl Iterator<Item = [f64; 3]>) -> Result<()> {
        let mut text = "x,y,z\n".to_owned();
        rows.for_each(|[x, y, z]| writeln!(text, "{x:?},{y:?},{z:?}").expect("text grows"));
        self.write_file(name, text)
    }

    /// Writes the positions of the transmitters, or the poses of a moving receiver. Returns the errors of [`Self::write_file`].
    fn write_locations(&self) -> Result<()> {
        let locations = self.data.locations.iter();
        match self.data.scene.moving {
            End::Transmitter => self.write_positions("tx_pos.csv", locations.map(pwrfgs_core::Location::position)),
            End::Receiver => self.write_file(POSES, poses_csv(locations.map(|location| location.pose))),
        }
    }

    /// Returns the poses of the fixed ends in the user's frame: of each receiver, or that of the transmitter for each one.
    fn fixed_poses(&self) -> impl Iterator<Item = Pose> + '_ {
        let (scene, ends) = (&self.data.scene, self.data.scene.fixed_ends());
        (0..scene.receivers.len()).map(move |r| scene.origin.world_pose(*ends.get(r).unwrap_or(&ends[0])))
    }

    /// Writes the point cloud and returns its file name; `None` if there are no points. Returns the errors of
    /// [`Self::write_file`].
    fn write_points(&self) -> Result<Option<PathBuf>> {
        let scene = &self.data.scene;
        if scene.points.is_empty() {
            return Ok(None);
        }
        self.write_positions(POINTS, scene.points.iter().map(|point| scene.origin.world(*point)))?;
        Ok(Some(POINTS.into()))
    }

    /// Returns an error unless there is one receiver.
    fn check_single_receiver(&self) -> Result<()> {
        match self.data.scene.receivers.len() {
            1 => Ok(()),
            n => refuse(&format!("there are {n} receivers, and a folder holds those of one; save a data set of each")),
        }
    }

    /// Returns whether a receiver has a stated carrier.
    fn has_carriers(&self) -> bool {
        self.data.scene.receivers.iter().any(|receiver| receiver.carrier_hz.is_some())
    }

    /// Returns the carrier of each link, Hz; `None` unless a reader restores the receivers from these: one receiver, or one array
    /// at ascending carriers whose receivers have the names of their carriers.
    fn link_carriers(&self) -> Option<Vec<f64>> {
        let receivers = &self.data.scene.receivers;
        let is_named =
            |receiver: &Receiver| receiver.carrier_hz.is_some_and(|hz| receiver.at_carrier(hz).name == receiver.name);
        let is_read_back = receivers.len() == 1
            || (receivers.iter().all(is_named) && receivers.is_sorted_by(|a, b| a.carrier_hz < b.carrier_hz));
        if !Receiver::are_carriers(receivers) || !is_read_back {
            return None;
        }
        self.data.links.iter().map(|link| receivers[link.receiver].carrier_hz).collect()
    }

    /// Writes the files of spectra that [`Arrays`] reads. Returns an error for receivers or carriers that it cannot read.
    fn write_spectra(&self, spectra: &Spectra) -> Result<()> {
        match self.link_carriers() {
            Some(carriers) => {
                self.write_file(CARRIERS, carriers.iter().map(|hz| format!("{hz:?}\n")).collect::<Vec<_>>().concat())?;
            }
            None if self.has_carriers() => {
                return refuse(
                    "these carriers have no layout on disk; save those of one receiver, named such as 2400MHz",
                );
            }
            None => self.check_single_receiver()?,
        }
        let scene = &self.data.scene;
        let pose = self.fixed_poses().next().unwrap_or(Pose::IDENTITY);
        let Elevation { first, last } = self.data.elevation;
        let elevation = format!("elevation: [{first:?}, {last:?}]\n"); // stated, pixels need not be square either
        let name = match &scene.receivers[..] {
            [only] => format!("receiver: {}\n", quote_yaml(&only.name)),
            _ => String::new(), // the names of carriers follow from their frequencies
        };
        self.write_file("gateway_info.yml", gateway_yaml(&self.data.title, &pose) + &elevation + &name)?;
        if scene.moving.is_receiver() {
            self.write_file(POSES, poses_csv(self.data.samples().map(|sample| sample.pose)))?;
        } else {
            let positions = self.data.samples().map(|sample| sample.position());
            if self.data.len() > MOST_POSITIONS {
                let problem = format!("tx.npy would have {} positions", self.data.len());
                return refuse(&format!("{problem}, more than the {MOST_POSITIONS} that can be read; save parts"));
            }
            let header = npy_header(Number::F64, &[self.data.len(), 3]);
            self.write_file(
                "tx.npy",
                header.into_iter().chain(positions.flatten().flat_map(f64::to_le_bytes)).collect::<Vec<u8>>(),
            )?;
        }
        let header = npy_header(spectra.number(), &[spectra.len(), spectra.height(), spectra.width()]);
        let mut file = GrowingFile::create(self.path.join("spectra.npy"), &header)?;
        (0..spectra.len()).try_for_each(|i| file.append(&spectra.raw(i)))?;
        file.finish()
    }

    /// Writes the files of `powers` `[links]`, dBm, that [`Nerf2Rssi`] reads. Returns an error for stated carriers.
    fn write_powers(&self, powers: &[Real]) -> Result<()> {
        if self.has_carriers() {
            return refuse("received powers at stated carriers have no layout on disk; keep the original files");
        }
        let receivers = &self.data.scene.receivers;
        let gateways = receivers.iter().map(|receiver| receiver.name.as_str()).zip(self.fixed_poses());
        self.write_file("gateway_position.yml", gateway_positions_yaml(gateways))?;
        self.write_locations()?;
        // Other programs read -100 as not received; if it is a reading, the cells of missing links are empty.
        let missing = if is_code_free(powers) { NOT_RECEIVED } else { f64::NAN };
        let mut cells = vec![missing; self.data.locations.len() * receivers.len()];
        for (link, dbm) in self.data.links.iter().zip(powers) {
            cells[link.location * receivers.len() + link.receiver] = *dbm as f64;
        }
        let names: Vec<String> = receivers.iter().map(|receiver| csv_cell(&receiver.name)).collect();
        let mut text = names.join(",") + "\n";
        for row in cells.chunks(receivers.len().max(1)) {
            for (k, dbm) in row.iter().enumerate() {
                text.push_str(if k == 0 { "" } else { "," });
                if !dbm.is_nan() {
                    write!(text, "{dbm:?}").expect("text grows");
                }
            }
            text.push('\n');
        }
        self.write_file("gateway_rssi.csv", text)
    }

    /// Writes the files of channels that [`Channels`] reads. Returns an error for several receivers.
    fn write_channels(&self, channels: &pwrfgs_core::Channels) -> Result<()> {
        self.check_single_receiver()?;
        let (scene, hz) = (&self.data.scene, &channels.frequencies_hz);
        let receiver = &scene.receivers[0];
        let pose = match scene.moving {
            End::Transmitter => scene.origin.world_pose(receiver.pose),
            End::Receiver => Pose::IDENTITY,
        };
        let [first, last] = [hz[0], hz[hz.len() - 1]];
        let band = [0.5 * (first + last), (last - first) / (hz.len() - 1).max(1) as f64];
        let absolute = |antenna: [f64; 3]| [0, 1, 2].map(|k| pose.position[k] + antenna[k]);
        let antennas: Vec<[f64; 3]> = receiver.array().into_iter().map(absolute).collect();
        let transmitter = scene.transmitter.map(|position| scene.origin.world_pose(position.into()).position);
        let text =
            receiver_yaml(&quote_yaml(&receiver.name), &pose, band, hz, &antennas) + &transmitter_yaml(transmitter);
        self.write_file("receiver.yml", text)?;
        self.write_locations()?;
        let descr = if size_of::<Real>() == 8 { "<c16" } else { "<c8" };
        let header = npy_header_as(descr, &[self.data.len(), channels.antennas, hz.len()]);
        let mut file = GrowingFile::create(self.path.join("channel.npy"), &header)?;
        let bytes = |i: usize| channels.of(i).iter().flatten().flat_map(|part| part.to_le_bytes()).collect::<Vec<u8>>();
        (0..self.data.len()).try_for_each(|i| file.append(&bytes(i)))?;
        file.finish()
    }

    /// Writes the IDs of the locations, unless they are those that the reader assigns: rows of spectra from 1, others from 0.
    /// Returns the errors of [`Self::write_file`].
    fn write_ids(&self) -> Result<()> {
        let Dataset { locations, links, .. } = self.data;
        let first_row = |l: usize| 1 + links.partition_point(|link| link.location < l);
        let assigned = |l: usize| if self.data.task().has_pixels { first_row(l) } else { l };
        if locations.iter().enumerate().all(|(l, location)| location.id as usize == assigned(l)) {
            return Ok(());
        }
        self.write_file(IDS, format_lines(locations.iter().map(|location| location.id as usize)))
    }

    /// Writes `manifest.json`: program version, title, whether the data are simulated, and the properties that no other file
    /// holds; `Manifest` in `folder.rs` reads these keys. Bounds of the scene are written only if they are not those of the
    /// data, such as in a subset. Returns the errors of [`Self::write_file`].
    fn write_manifest(&self) -> Result<()> {
        let (data, scene) = (self.data, &self.data.scene);
        let mut manifest = serde_json::json!({
            "program": concat!("pwrfgs ", env!("CARGO_PKG_VERSION")),
            "simulated": data.is_simulated(),
            "name": data.title,
            "title": data.title,
        });
        if let Some(powers) = data.observations.powers() {
            manifest["missing"] = serde_json::json!(if is_code_free(powers) { vec![NOT_RECEIVED] } else { vec![] });
            manifest["unit"] = if scene.receivers.iter().any(|r| r.is_relative) { RELATIVE } else { "dBm" }.into();
        }
        if let Some(geodetic) = scene.geodetic {
            manifest["geodetic"] = serde_json::json!(geodetic);
        }
        if !scene.floors.is_empty() {
            manifest["floors"] = serde_json::json!(scene.floors);
        }
        let estimated: Vec<&str> = scene.receivers.iter().filter(|r| r.is_estimated).map(|r| &*r.name).collect();
        for (key, names) in
            [("estimated_receivers", estimated), ("accepted", data.accepted.iter().map(|n| &**n).collect())]
        {
            if !names.is_empty() {
                manifest[key] = serde_json::json!(names);
            }
        }
        // The bounds that the reader computes depend on points, locations and ends alone: one link is enough.
        let points = scene.points.iter().map(|point| scene.origin.world(*point)).collect();
        let (locations, links) = (data.locations.clone(), data.links[..1].to_vec());
        let reader = Dataset::of_columns("", scene.ends(), points, locations, links, vec![0.0].into())?.scene;
        if (reader.origin, reader.bounds) != (scene.origin, scene.bounds) {
            let (low, high) = scene.bounds;
            manifest["bounds"] = serde_json::json!([low, high].map(|corner| scene.origin.world(corner)));
        }
        self.write_file("manifest.json", format!("{manifest:#}\n"))
    }

    /// Writes the official split of the data as index files, if there is one. Returns the errors of [`Self::write_file`].
    fn write_index_files(&self) -> Result<()> {
        let Some((train, test)) = &self.data.official else { return Ok(()) };
        let row = |link: &usize| {
            if self.data.task().has_pixels { link + 1 } else { self.data.links[*link].location }
        };
        for (name, links) in [("train_index.txt", train), ("test_index.txt", test)] {
            let mut rows: Vec<usize> = links.iter().map(row).collect();
            rows.dedup();
            self.write_file(name, format_lines(rows))?;
        }
        Ok(())
    }
}
