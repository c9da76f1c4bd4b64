//! `House`: the sides of a page, who looks at it, and what happens meanwhile.

use crate::side::{Side, facts};
use pwrfgs_experiment::folder::{CHECKPOINT, CURVE, FACTS, MODEL_FILE};
use pwrfgs_experiment::record::read_series;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};
use tokio::sync::broadcast;

/// How often a run under way is looked at.
const LOOK: Duration = Duration::from_millis(500);

/// What a server shows.
pub(crate) struct House {
    pub(crate) sides: Vec<Side>,
    watched: AtomicBool,
    watchers: AtomicUsize,
    news: broadcast::Sender<String>,
}

impl House {
    pub(crate) fn new(sides: Vec<Side>) -> Arc<Self> {
        let (news, _) = broadcast::channel(64);
        let house = Arc::new(Self { sides, watched: AtomicBool::new(false), watchers: AtomicUsize::new(0), news });
        for side in 0..house.sides.len() {
            let behind = house.sides[side].folder.clone().filter(|folder| !folder.join(MODEL_FILE).is_file());
            if let Some(folder) = behind {
                let house = Arc::downgrade(&house);
                std::thread::spawn(move || {
                    let mut seen = [None; 2];
                    while let Some(house) = house.upgrade() {
                        if house.follow(side, &folder, &mut seen) {
                            break;
                        }
                        drop(house);
                        std::thread::sleep(LOOK);
                    }
                });
            }
        }
        house
    }

    /// Somebody looks at the page until what this gives is dropped.
    pub(crate) fn watch(self: &Arc<Self>) -> (broadcast::Receiver<String>, Watcher) {
        self.watched.store(true, Ordering::Relaxed);
        self.watchers.fetch_add(1, Ordering::Relaxed);
        (self.news.subscribe(), Watcher(Arc::clone(self)))
    }

    /// Whether anybody has looked, and how many do.
    pub(crate) fn watchers(&self) -> (bool, usize) {
        (self.watched.load(Ordering::Relaxed), self.watchers.load(Ordering::Relaxed))
    }

    /// Tells of what has changed in the folder of a run under way; whether it has ended.
    fn follow(&self, side: usize, folder: &Path, seen: &mut [Option<SystemTime>; 2]) -> bool {
        let changed = |name: &str| std::fs::metadata(folder.join(name)).and_then(|file| file.modified()).ok();
        let now = [changed(CURVE), changed(MODEL_FILE).or_else(|| changed(CHECKPOINT))];
        if *seen == now {
            return false;
        }
        let reload = seen[1] != now[1];
        *seen = now;
        let ended = reload && self.sides[side].reload().unwrap_or(false);
        let known = self.sides[side].known.as_ref();
        let rows = read_series(&folder.join(CURVE));
        let field = |k: usize| rows.last().and_then(|row| row.get(k).copied().flatten());
        let finished = ended && folder.join(FACTS).is_file() && facts(folder).is_some();
        let news = json!({
            "side": side, "step": field(0), "loss": field(2), "gaussians": field(4), "changed": reload, "finished": finished,
            "steps": known.map(|known| known.pipeline.training.steps),
        });
        _ = self.news.send(news.to_string());
        finished
    }
}

/// Counts one who looks.
pub(crate) struct Watcher(Arc<House>);

impl Drop for Watcher {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::Relaxed);
    }
}
