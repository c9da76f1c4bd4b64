//! `ServerState`: the panes of the page, and the events about runs in progress.

use crate::side::ViewPane;
use pwrfgs_experiment::Facts;
use pwrfgs_experiment::folder::{CHECKPOINT, CURVE, CURVE_GAUSSIANS, CURVE_LOSS, FACTS, MODEL_FILE, training_folder};
use pwrfgs_experiment::record::read_series;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};
use tokio::sync::broadcast;

/// Columns of `curve.csv` on the page: step, loss and number of Gaussians.
pub(crate) const CURVE_COLUMNS: [usize; 3] = [0, CURVE_LOSS, CURVE_GAUSSIANS];
/// Interval between checks of a run in progress.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Number of events that a slow page may miss at once.
const QUEUED_EVENTS: usize = 64;

/// State of the server.
pub(crate) struct ServerState {
    pub(crate) sides: Vec<ViewPane>,
    /// Whether a page was opened.
    watched: AtomicBool,
    /// Number of open pages.
    watchers: AtomicUsize,
    events: broadcast::Sender<String>,
}

impl ServerState {
    /// Creates the state, and starts a thread per run in progress that sends events about its changes.
    pub(crate) fn new(sides: Vec<ViewPane>) -> Arc<Self> {
        let (events, _) = broadcast::channel(QUEUED_EVENTS);
        let state = Arc::new(Self { sides, watched: AtomicBool::new(false), watchers: AtomicUsize::new(0), events });
        for side in 0..state.sides.len() {
            let running = state.sides[side].folder.clone().filter(|folder| !folder.join(MODEL_FILE).is_file());
            if let Some(folder) = running {
                let state = Arc::downgrade(&state);
                std::thread::spawn(move || {
                    let mut times = [None; 2];
                    while state.upgrade().is_some_and(|state| !state.send_change(side, &folder, &mut times)) {
                        std::thread::sleep(POLL_INTERVAL);
                    }
                });
            }
        }
        state
    }

    /// Registers an open page until the guard is dropped; also returns the receiver of its events.
    pub(crate) fn register_page(self: &Arc<Self>) -> (broadcast::Receiver<String>, WatcherGuard) {
        self.watched.store(true, Ordering::Relaxed);
        self.watchers.fetch_add(1, Ordering::Relaxed);
        (self.events.subscribe(), WatcherGuard(Arc::clone(self)))
    }

    /// Returns whether a page was opened, and all pages are closed.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.watched.load(Ordering::Relaxed) && self.watchers.load(Ordering::Relaxed) == 0
    }

    /// Sends an event to all pages if the files of the run in `folder` changed since `times`, which it updates: those
    /// of the curve, and of model or checkpoint. Returns whether the run has finished: its model and `run.json` can be
    /// read.
    fn send_change(&self, side: usize, folder: &Path, times: &mut [Option<SystemTime>; 2]) -> bool {
        let (_, training) = training_folder(folder);
        let modified = |path: PathBuf| std::fs::metadata(path).and_then(|file| file.modified()).ok();
        let model = modified(folder.join(MODEL_FILE)).or_else(|| modified(training.join(CHECKPOINT)));
        let now = [modified(training.join(CURVE)), model];
        if *times == now {
            return false;
        }
        let reload = times[1] != now[1];
        *times = now;
        let ended = reload && self.sides[side].reload().unwrap_or(false);
        let loaded = self.sides[side].loaded.as_ref();
        let rows = read_series(&training.join(CURVE));
        let [step, loss, gaussians] = CURVE_COLUMNS.map(|k| rows.last().and_then(|row| row.get(k).copied().flatten()));
        let finished = ended && folder.join(FACTS).is_file() && matches!(Facts::read(folder), Ok(Some(_)));
        let event = json!({
            "side": side, "step": step, "loss": loss, "gaussians": gaussians, "changed": reload, "finished": finished,
            "steps": loaded.map(|loaded| loaded.pipeline.training.steps),
        });
        _ = self.events.send(event.to_string());
        finished
    }
}

/// Registration of an open page.
pub(crate) struct WatcherGuard(Arc<ServerState>);

impl Drop for WatcherGuard {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::Relaxed);
    }
}
