//! One file a verb: what can be said to it, and what it does.

mod changes;
mod check;
mod completions;
mod evaluate;
mod export;
mod import;
mod init;
mod inspect;
#[cfg(feature = "report")]
mod map;
mod plugins;
mod predict;
mod receivers;
#[cfg(feature = "report")]
mod report;
mod run;
#[cfg(feature = "raytrace")]
mod simulate;
mod sweep;
#[cfg(feature = "viewer")]
mod view;

pub(crate) use check::{Check, check, memory, pace};
pub(crate) use completions::{Completions, Man, completions, man};
pub(crate) use evaluate::{Evaluate, evaluate};
pub(crate) use export::{Export, export};
pub(crate) use import::{Import, import};
pub(crate) use init::{Init, init};
pub(crate) use inspect::{Inspect, inspect};
#[cfg(feature = "report")]
pub(crate) use map::{Map, map};
pub(crate) use plugins::{Plugins, plugins};
pub(crate) use predict::{Predict, predict};
#[cfg(feature = "report")]
pub(crate) use report::{Report, report};
pub(crate) use run::{Run, run};
#[cfg(feature = "raytrace")]
pub(crate) use simulate::{Simulate, simulate};
pub(crate) use sweep::{Sweep, sweep};
#[cfg(feature = "viewer")]
pub(crate) use view::{View, view};
