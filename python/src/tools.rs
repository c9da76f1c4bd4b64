//! `simulate`, `sweep` and `report`, as the command line has them.

use crate::border::{raised, waited, wrong};
use pwrfgs::experiment::sweep::{JOINED, Plan, SweepEnd, check, execute};
use pwrfgs::experiment::{Outcome, Session};
use pwrfgs::prelude::Silent;
use pwrfgs::raytrace::output::{self as folder, Layout};
use pwrfgs::raytrace::{Observe, Recipe};
use pwrfgs::report::{Study, write};
use pyo3::prelude::*;
use std::path::PathBuf;

/// See `pwrfgs.simulate`.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // settings with names, as Python has them
pub(crate) fn simulate(
    py: Python<'_>,
    scene: PathBuf,
    out: PathBuf,
    layout: &str,
    samples: usize,
    seed: u64,
    points: usize,
    noise_db: Option<f64>,
    snr_db: Option<f64>,
    paths: bool,
    hear: &Bound<'_, PyAny>,
) -> PyResult<()> {
    if snr_db.is_some() && !matches!(layout, "channels" | "csi") {
        let what = "snr_db is for channels: say layout=\"channels\", or set the `noise` of the scene for spectra";
        return Err(wrong(py, what));
    }
    if noise_db.is_some() && layout != "rssi" {
        return Err(wrong(py, "noise_db is for powers: say layout=\"rssi\""));
    }
    let (observe, layout) = match layout {
        "spectra" => (Observe::Spectrum, Layout::Pictures),
        "arrays" => (Observe::Spectrum, Layout::Array),
        "rssi" => (Observe::Power { noise_db: noise_db.unwrap_or(0.0) }, Layout::Rssi),
        "channels" => (Observe::Channel { snr_db }, Layout::Channels),
        "csi" => (Observe::Channel { snr_db }, Layout::Csi),
        other => {
            let all = ["spectra", "arrays", "rssi", "channels", "csi"];
            let hint = pwrfgs_core::did_you_mean(other, all);
            return Err(wrong(py, &format!("layout: there is no `{other}`{hint} (there are {})", all.join(", "))));
        }
    };
    let recipe = Recipe::read(&scene, samples, seed, points).and_then(|recipe| recipe.observing(observe));
    let recipe = recipe.map_err(|error| raised(py, error))?;
    let work = |events: std::sync::mpsc::SyncSender<(usize, usize)>, stop: &_| {
        let tell = |done, total| _ = events.try_send((done, total));
        folder::write_as(&recipe, layout, paths, &out, &tell, stop)
    };
    waited(py, work, |(done, total)| hear.call1((done, total)).map(|_| ()))
}

/// Of every run, and last of the joined model, its folder, and why it failed, if it did.
type Ends = Vec<(PathBuf, Option<String>)>;

/// See `pwrfgs.sweep`: the sweep folder, and of every run its folder and why it failed, if it did.
#[pyfunction]
pub(crate) fn sweep(
    py: Python<'_>,
    experiment: PathBuf,
    arguments: Vec<String>,
    out: Option<PathBuf>,
    jobs: usize,
) -> PyResult<(PathBuf, Ends)> {
    let plan = Plan::read(&experiment, &arguments, out.as_deref()).map_err(|error| raised(py, error))?;
    let runs: Vec<usize> = (0..plan.runs.len()).collect();
    let work = |_: std::sync::mpsc::SyncSender<()>, stop: &std::sync::atomic::AtomicBool| {
        check(&plan, &runs, &mut Silent)?;
        let mut session = Session { observer: &mut Silent, stop, page: pwrfgs::PAGE };
        let SweepEnd { runs: ends, joined } = execute(&plan, &runs, jobs, &Silent, &mut session)?;
        let whole = ends.len() == runs.len() && ends.iter().all(|(_, end)| matches!(end, Ok(Outcome::Finished { .. })));
        if whole {
            let _held = plan.claim()?;
            let study = Study::read(std::slice::from_ref(&plan.folder))?;
            write(&study, None, &plan.folder.join("report"), &mut Silent)?;
        }
        Ok((ends, joined))
    };
    let (ends, joined) = waited(py, work, |()| Ok(()))?;
    let failed = |end: pwrfgs_core::Result<Outcome>| match end {
        Err(error) => Some(error.to_string()),
        Ok(Outcome::Finished { .. }) => None,
        Ok(Outcome::Interrupted { .. } | Outcome::Unscored) => Some("stopped; the same call goes on".into()),
    };
    let runs = ends.into_iter().map(|(run, end)| (plan.folder_of(run), failed(end)));
    let joined = joined.map(|end| (plan.folder.join(JOINED), failed(Ok(end))));
    Ok((plan.folder.clone(), runs.chain(joined).collect()))
}

/// See `pwrfgs.report`: the tables as text.
#[pyfunction]
pub(crate) fn report(py: Python<'_>, runs: Vec<PathBuf>, out: PathBuf, reference: Option<String>) -> PyResult<String> {
    let work = |_: std::sync::mpsc::SyncSender<()>, _: &_| {
        let study = Study::read(&runs)?;
        write(&study, reference.as_deref(), &out, &mut Silent)
    };
    waited(py, work, |()| Ok(()))
}
