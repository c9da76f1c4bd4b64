//! `pwrfgs init`: a commented pipeline for the data in a folder.

mod survey;

use crate::output::{self, Verbosity};
use crate::progress::Progress;
use crate::reference::commented::{Style, Value};
use crate::reference::example;
use clap::Args;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::Docs;
use pwrfgs_core::files::{check_place, write_new};
use pwrfgs_core::plugin::{to_ron, try_to_ron};
use pwrfgs_core::{Error, Result, recognise};
use std::path::{Path, PathBuf};
use survey::Survey;
pub(super) use survey::name_of;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Looks at the data: spectra, received powers or channels in the layouts of NeRF2, or channels as an \
    array (docs/data.md, docs/links.md); positions, index files, a point cloud. The pipeline it writes runs as it is; every line says what it does. Where the data bring no index files it suggests a \
    split that holds out space, so that no test transmitter stands beside a training one. Nothing is ever \
    overwritten.\n\nEXAMPLES\n  pwrfgs init data/s23\n  pwrfgs init data/s23 --out pipelines/mine.ron"
)]
pub(crate) struct Init {
    /// The folder with the data
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub(crate) folder: PathBuf,
    /// The pipeline file [default: NAME.ron where you stand, after the folder]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

/// Median distance from a test transmitter to the nearest training one, metres, below which training learns fine detail.
const CLOSE_M: f64 = 0.03;

/// Fields of a pipeline that the file shows; the others have their defaults.
const SHOWN: [&str; 9] =
    ["name", "seed", "data", "split", "initializer", "deformation", "readout", "pruners", "training"];

/// Those of them that another method does not read.
const OF_SPLATS: [&str; 2] = ["deformation", "readout"];

/// The shipped pipelines that new ones start from.
const FINE_SPECTRA: &str = include_str!("../../../../pipelines/s23-laptop.ron");
const COARSE_SPECTRA: &str = include_str!("../../../../pipelines/quickstart.ron");
const POWERS: &str = include_str!("../../../../pipelines/ble.ron");
const CHANNELS: &str = include_str!("../../../../pipelines/office-channel.ron");
const UPLINKS: &str = include_str!("../../../../pipelines/uplink.ron");

pub(crate) fn init(arguments: &Init, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.ron", name_of(&arguments.folder))));
    let exists = || Error::input(&out, "exists, and nothing is overwritten; name another file with --out");
    if out.symlink_metadata().is_ok() {
        return Err(exists());
    }
    check_place(&out)?;
    let survey = Progress::during(verbosity, |progress| Survey::of(&arguments.folder, progress))?;
    let pipeline = pipeline(&survey, &arguments.folder, &out)?;
    let text = written(&survey, &pipeline)?;
    if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
    }
    if !write_new(&out, text.as_bytes())? {
        return Err(exists());
    }
    output::result(&format!("{}: {}\nnext: pwrfgs run {}\n", out.display(), survey.sentence(), out.display()))
}

/// What is suggested for these data.
fn pipeline(survey: &Survey, folder: &Path, out: &Path) -> Result<Pipeline> {
    // Paths in a pipeline are relative to its file.
    let beside = out.parent().is_none_or(|parent| parent.as_os_str().is_empty());
    let root =
        if beside { folder.to_owned() } else { std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()) };
    let path = |path: &Path| {
        let text = path.to_str().map(|text| format!("{text:?}"));
        text.ok_or_else(|| Error::input(path, "not UTF-8; rename the folder"))
    };
    path(&root)?;
    let source = recognise(&root).unwrap_or_else(|| survey.source.clone());
    let mut set = vec![
        format!("name={}", name_of(folder)),
        format!("data={}", try_to_ron(&source).map_err(Error::Config)?),
        format!("split={}", survey.split),
    ];
    let start = match survey.features {
        _ if survey.task.has_pixels => {
            let stride = survey.stride();
            set.push(format!("training.stride={stride}"));
            set.push(format!("training.batch={}", survey.transmitters.clamp(1, 32)));
            set.push(
                "baselines=[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()]".into(),
            );
            if stride == 1 {
                set.push("projector=Mercator()".into());
            }
            match survey.clouds.first() {
                Some((name, _)) => {
                    set.push(format!("data.points={}", path(&root.join(name))?));
                    set.push("initializer=PointCloud(max_points: 300)".into());
                }
                None => set.push("initializer=Grid(count: 220, overlap: 1.0, opacity: 0.12)".into()),
            }
            if survey.nearest < CLOSE_M { FINE_SPECTRA } else { COARSE_SPECTRA }
        }
        _ if survey.task.is_scalar => {
            // Waves from the size of the site to 2 m, or to an eighth of a small one.
            let longest = survey.extent.max(1.0).ceil();
            set.push(format!("deformation.tx_encoding.longest_m={longest:?}"));
            set.push(format!("deformation.tx_encoding.shortest_m={:?}", (longest / 8.0).min(2.0)));
            set.push(format!("training.batch={}", survey.transmitters.clamp(1, 128)));
            POWERS
        }
        Some(width) => {
            set.push(format!("method.deformation.tx_encoding=Features(width: {width})"));
            set.push(format!("training.batch={}", survey.transmitters.clamp(1, 128)));
            UPLINKS
        }
        None => {
            set.push(format!("training.batch={}", survey.transmitters.clamp(1, 256)));
            CHANNELS
        }
    };
    let mut pipeline = Pipeline::parse(start, out)?;
    pipeline.set_all(&set)?;
    Ok(pipeline)
}

/// The text of the file.
fn written(survey: &Survey, pipeline: &Pipeline) -> Result<String> {
    let default = example().map_err(Error::Config)?;
    let value = Value::new(to_ron(pipeline)).map_err(Error::Config)?;
    let differs = |path: &[&str]| value.at(path) != default.at(path);
    let draws = !differs(&["method"]);
    let shows = |owner: &str, field: &str| match owner {
        "Pipeline" => differs(&[field]) || SHOWN.contains(&field) && (draws || !OF_SPLATS.contains(&field)),
        "Training" => !["loss", "optimizer", "densify"].contains(&field) || differs(&["training", field]),
        "Loss" | "Optimizer" | "Densify" => differs(&["training", &owner.to_lowercase(), field]),
        _ => true,
    };
    let style = Style { opens: &|field| field != "receiver", shows: &shows };
    let body = style.write(&value, Some(Docs::of::<Pipeline>()), "");
    let mut text = String::new();
    for line in survey.notes() {
        text += &wrapped(&line, ["// "; 2], 100);
    }
    text += "//\n// What is left out has its default: `pwrfgs plugins` shows everything that could stand here, and \
             `pwrfgs plugins NAME`\n// a part of it. What a line takes stands in brackets.\n";
    text += &body;
    text.push('\n');
    // What was written must say what was meant.
    let again = Pipeline::parse(&text, Path::new("the new pipeline"))?;
    if again.to_ron() != pipeline.to_ron() {
        return Err(Error::Config("the new pipeline does not read as it was meant; please report this".into()));
    }
    Ok(text)
}
