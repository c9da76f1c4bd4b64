//! A data set that is in memory becomes a folder.

use crate::layout::{gateway_positions_yaml, gateway_yaml, receiver_yaml};
use crate::npy::{npy_header, npy_header_as};
use crate::{Arrays, Channels, Nerf2Rssi};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::words::cell;
use pwrfgs_core::{DataSource, Dataset, Elevation, Error, Number, Observations, Result, Spectra};
use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// A point cloud, where there is one.
const POINTS: &str = "points.csv";

/// Writes the new folder `out`, whole or not at all, and gives what reads it: spectra as [`Arrays`], powers as
/// [`Nerf2Rssi`], channels as [`Channels`]. Transmitters are numbered anew, in their order.
///
/// # Errors
/// Where a layout cannot hold the data, `out` holds something, or the disk refuses.
pub fn save(data: &Dataset, out: &Path) -> Result<Box<dyn DataSource>> {
    if data.features.is_some() || !data.placed {
        return refuse("transmitters without positions have no layout of their own; keep the files they came from");
    }
    let folder = NewFolder::begin(out)?;
    let to = Folder { path: folder.path(), data };
    let points = to.points()?;
    let points_of_out = || points.as_ref().map(|name| out.join(name));
    let source: Box<dyn DataSource> = match &data.observations {
        Observations::Pictures(spectra) => {
            to.spectra(spectra)?;
            Box::new(Arrays { root: out.into(), points: points_of_out(), ..Arrays::default() })
        }
        Observations::Powers(powers) => {
            to.powers(powers.iter().map(|dbm| *dbm as f64).collect())?;
            Box::new(Nerf2Rssi { root: out.into(), points: points_of_out() })
        }
        Observations::Channels(channels) => {
            to.channels(channels)?;
            Box::new(Channels { root: out.into(), ..Channels::default() })
        }
    };
    to.manifest()?;
    to.official()?;
    folder.publish()?;
    Ok(source)
}

fn refuse<T>(what: &str) -> Result<T> {
    Err(Error::Config(format!("save: {what}")))
}

/// Where to, and what.
struct Folder<'a> {
    path: &'a Path,
    data: &'a Dataset,
}

impl Folder<'_> {
    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) -> Result<()> {
        let path = self.path.join(name);
        fs::write(&path, bytes).map_err(|e| Error::write(&path, e))
    }

    /// Text rows below a header.
    fn table(&self, name: &str, rows: impl Iterator<Item = [f64; 3]>) -> Result<()> {
        let mut text = "x,y,z\n".to_owned();
        rows.for_each(|[x, y, z]| writeln!(text, "{x:?},{y:?},{z:?}").expect("text grows"));
        self.put(name, text)
    }

    fn transmitters(&self) -> Result<()> {
        self.table("tx_pos.csv", self.data.transmitters.iter().map(|tx| tx.position))
    }

    /// The file of the point cloud; none where there are no points.
    fn points(&self) -> Result<Option<PathBuf>> {
        let scene = &self.data.scene;
        if scene.points.is_empty() {
            return Ok(None);
        }
        self.table(POINTS, scene.points.iter().map(|point| scene.origin.world(*point)))?;
        Ok(Some(POINTS.into()))
    }

    /// Every transmitter at the only receiver.
    fn alone(&self) -> Result<()> {
        match self.data.scene.receivers.len() {
            1 => Ok(()),
            n => refuse(&format!("there are {n} receivers, and a folder holds those of one; save a data set of each")),
        }
    }

    fn spectra(&self, spectra: &Spectra) -> Result<()> {
        self.alone()?;
        let scene = &self.data.scene;
        let pose = scene.origin.world_pose(scene.pose());
        let Elevation { first, last } = self.data.elevation;
        let elevation = format!("elevation: [{first:?}, {last:?}]\n"); // stated, pixels need not be square either
        self.put("gateway_info.yml", gateway_yaml(&self.data.title, &pose) + &elevation)?;
        let numbers = self.data.transmitters.iter().flat_map(|tx| tx.position).flat_map(f64::to_le_bytes);
        let header = npy_header(Number::F64, &[self.data.transmitters.len(), 3]);
        self.put("tx.npy", header.into_iter().chain(numbers).collect::<Vec<u8>>())?;
        let header = npy_header(spectra.number(), &[spectra.len(), spectra.height(), spectra.width()]);
        let path = self.path.join("spectra.npy");
        let write = || {
            let mut file = BufWriter::with_capacity(1 << 20, fs::File::create(&path)?);
            file.write_all(&header)?;
            (0..spectra.len()).try_for_each(|i| file.write_all(&spectra.raw(i)))?;
            file.flush()
        };
        write().map_err(|e| Error::write(&path, e))
    }

    #[allow(clippy::needless_pass_by_value)] // made for this
    fn powers(&self, dbm: Vec<f64>) -> Result<()> {
        let receivers = &self.data.scene.receivers;
        let origin = self.data.scene.origin;
        let place = |receiver: &pwrfgs_core::Receiver| origin.world_pose(receiver.pose).position;
        let all = receivers.iter().map(|receiver| (receiver.name.as_str(), place(receiver)));
        self.put("gateway_position.yml", gateway_positions_yaml(all))?;
        self.transmitters()?;
        let mut cells = vec![-100.0; self.data.transmitters.len() * receivers.len()];
        for (link, dbm) in self.data.links.iter().zip(dbm) {
            cells[link.transmitter * receivers.len() + link.receiver] = dbm;
        }
        let names: Vec<_> = receivers.iter().map(|receiver| cell(&receiver.name)).collect();
        let mut text = names.join(",") + "\n";
        for row in cells.chunks(receivers.len().max(1)) {
            text += &row.iter().map(|dbm| format!("{dbm:?}")).collect::<Vec<_>>().join(",");
            text.push('\n');
        }
        self.put("gateway_rssi.csv", text)
    }

    fn channels(&self, channels: &pwrfgs_core::Channels) -> Result<()> {
        self.alone()?;
        let (scene, hz) = (&self.data.scene, &channels.frequencies_hz);
        let spacing = if hz.len() > 1 { (hz[hz.len() - 1] - hz[0]) / (hz.len() - 1) as f64 } else { 0.0 };
        let even = |(i, f): (usize, &f64)| (hz[0] + i as f64 * spacing - f).abs() <= 1e-6 * spacing.abs();
        if !hz.iter().enumerate().all(even) || (hz.len() > 1 && spacing <= 0.0) {
            return refuse("the subcarriers are not evenly spaced and rising, as the layout has them");
        }
        let carrier = 0.5 * (hz[0] + hz[hz.len() - 1]);
        self.put("receiver.yml", receiver_yaml(&scene.receivers[0], scene.origin, carrier, spacing))?;
        self.transmitters()?;
        let header = npy_header_as("<c8", &[self.data.len(), channels.antennas, hz.len()]);
        let bytes = channels.gains.iter().flatten().flat_map(|part| (*part as f32).to_le_bytes());
        self.put("channel.npy", header.into_iter().chain(bytes).collect::<Vec<u8>>())
    }

    fn manifest(&self) -> Result<()> {
        let manifest = serde_json::json!({
            "program": concat!("pwrfgs ", env!("CARGO_PKG_VERSION")),
            "simulated": self.data.is_simulated(),
            "name": self.data.title,
        });
        self.put("manifest.json", format!("{manifest:#}\n"))
    }

    /// The split that the data bring, as index files.
    fn official(&self) -> Result<()> {
        let Some((train, test)) = &self.data.official else { return Ok(()) };
        let first = usize::from(self.data.kind() == pwrfgs_core::Kind::Spectrum);
        for (name, links) in [("train_index.txt", train), ("test_index.txt", test)] {
            let mut rows: Vec<usize> = links.iter().map(|&link| self.data.links[link].transmitter + first).collect();
            rows.dedup();
            let mut text = String::new();
            rows.iter().for_each(|row| writeln!(text, "{row}").expect("text grows"));
            self.put(name, text)?;
        }
        Ok(())
    }
}

/// The plugin that reads a folder, by the files in it, and its settings besides `root`; nothing where it holds no data.
pub fn source_in(folder: &Path) -> Option<(&'static str, &'static str, Box<dyn DataSource>)> {
    let holds = |names: [&str; 2]| names.iter().any(|name| folder.join(name).exists());
    let root = || folder.to_owned();
    let points = || [POINTS, "points.ply"].map(|name| folder.join(name)).into_iter().find(|path| path.exists());
    Some(if holds(["gateway_rssi.csv", "gateway_position.yml"]) {
        ("Nerf2Rssi", "", Box::new(Nerf2Rssi { root: root(), points: points() }))
    } else if holds(["csidata.npy", "base-station.yml"]) {
        let csi = crate::Nerf2Csi { root: root(), together: true, ..crate::Nerf2Csi::default() };
        ("Nerf2Csi", ", together: true", Box::new(csi))
    } else if holds(["channel.npy", "receiver.yml"]) {
        ("Channels", "", Box::new(Channels { root: root(), ..Channels::default() }))
    } else if holds(["spectra.npy"; 2]) {
        ("Arrays", "", Box::new(Arrays { root: root(), points: points(), ..Arrays::default() }))
    } else if holds(["spectrum", "gateway_info.yml"]) {
        let spectra = crate::Nerf2Spectrum { root: root(), points: points(), ..crate::Nerf2Spectrum::default() };
        ("Nerf2Spectrum", "", Box::new(spectra))
    } else {
        return None;
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Channels as Gains, Pose, Receiver, Sample, Simulation};

    fn again(data: &Dataset) -> Dataset {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("saved");
        let source = save(data, &out).unwrap();
        let (_, _, found) = source_in(&out).unwrap();
        let alike = format!("{:?}", found.load(Path::new(""), &|_, _| {}).unwrap());
        assert_eq!(alike, format!("{:?}", source.load(Path::new(""), &|_, _| {}).unwrap()), "found as written");
        assert!(save(data, &out).is_err(), "what lies there stays");
        source.load(Path::new(""), &|_, _| {}).unwrap()
    }

    fn same(data: &Dataset, again: &Dataset) {
        assert_eq!((data.len(), data.width, data.height), (again.len(), again.width, again.height));
        assert_eq!(data.samples().map(|s| s.tx).collect::<Vec<_>>(), again.samples().map(|s| s.tx).collect::<Vec<_>>());
        assert_eq!((&data.official, &data.scene.points), (&again.official, &again.scene.points));
        assert!((0..data.len()).all(|i| data.image(i) == again.image(i)));
        assert_eq!(data.elevation, again.elevation);
        assert_eq!(data.is_simulated(), again.is_simulated());
    }

    #[test]
    fn what_is_saved_is_read_again() {
        let pose = Pose { position: [0.25, 1.0, 2.0], ..Pose::IDENTITY };
        let samples: Vec<Sample> = (1..=3).map(|i| Sample::new(i, [f64::from(i) / 3.0, 0.5, 1.0])).collect();
        let spectra = Spectra::float((30, 8), &(0..720).map(|v| v as f32 / 720.0).collect::<Vec<_>>()).unwrap();
        let mut data = Dataset::new("room", pose, vec![[1.0, 2.0, 0.125]], samples.clone(), spectra).unwrap();
        data.official = Some((vec![0, 2], vec![1]));
        data.simulation = Some(Simulation::default());
        same(&data, &again(&data));
        data.elevation = Elevation { first: 80.0, last: -10.0 }; // pixels that are not square, from above to below
        same(&data, &again(&data));

        let at = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
        let samples =
            [(0, 0), (0, 1), (1, 1)].map(|(id, receiver)| Sample { id, tx: [f64::from(id), 2.0, 1.5], receiver });
        let powers = Observations::Powers(vec![-61.5, -70.25, -80.0]);
        let data = Dataset::of_links("hall", vec![at("=n()", 0.0), at("s", 9.0)], vec![], &samples, powers).unwrap();
        same(&data, &again(&data));
        assert_eq!(data.scene.receivers, again(&data).scene.receivers);

        let receiver = Receiver { antennas: vec![[0.0; 3], [0.0, 0.0625, 0.0]], ..at("array", 1.0) };
        let samples: Vec<Sample> = (0..2).map(|i| Sample::new(i, [f64::from(i), 2.0, 1.5])).collect();
        let gains = (0..12).map(|v| [v as pwrfgs_core::Real, -1.0]).collect();
        let channels = Gains { antennas: 2, frequencies_hz: vec![2.3e9, 2.4e9, 2.5e9], gains };
        let data =
            Dataset::of_links("channels", vec![receiver], vec![], &samples, Observations::Channels(channels)).unwrap();
        let back = again(&data);
        same(&data, &back);
        assert_eq!(data.scene.receivers, back.scene.receivers);
    }
}
