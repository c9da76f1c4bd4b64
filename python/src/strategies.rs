//! Strategies that are written in Python: the host that makes them, and each as the trait that a run knows.
//!
//! An exception has no place in the signatures of those traits; where there is none it unwinds to the border, and the run
//! ends as by any other failed step, its checkpoint kept.

use crate::arrays::{Gain, array, axes, complex, given, numbers};
use crate::border::{carried, throw, wrong};
use dfdx::tensor_ops::SumTo as _;
use pwrfgs::foreign::{Host, Python as Named, set_host};
use pwrfgs_core::tape::{Trace, TraceScalar, Traced, op};
use pwrfgs_core::{
    Baseline, CloudStats, ColumnSpec, Dataset, Error, Evaluation, ExtraColumn, Gate, GaussianCloud, Goal, Image,
    ImagePlane, Initializer, Kind, Known, Measurement, Metric, Moment, Needs, Partition, Predict, Pruner, Query, Real,
    Result, Scene, Split, Statistic, Values, gains_of, logit, rng, rows_of,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Registers the host.
pub(crate) fn begin() {
    set_host(Box::new(Interpreter::default()));
}

/// Makes objects of Python, each once.
#[derive(Default)]
struct Interpreter {
    made: Mutex<BTreeMap<(&'static str, Named), Arc<Object>>>,
}

/// An object of a user's class.
#[derive(Debug)]
struct Object {
    own: Py<PyAny>,
    /// The methods that its class has beside what every strategy has: the others are not called.
    has: BTreeSet<String>,
    /// Of a pruner, what it asks for.
    columns: Vec<ColumnSpec>,
}

impl Interpreter {
    fn object(&self, kind: &'static str, which: &Named) -> Result<Arc<Object>> {
        let key = (kind, which.clone());
        if let Some(object) = self.made.lock().unwrap_or_else(PoisonError::into_inner).get(&key) {
            return Ok(Arc::clone(object));
        }
        // Not under the lock: Python may call back.
        let object = Arc::new(Python::attach(|py| Object::make(py, kind, which)).map_err(carried)?);
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::clone(made.entry(key).or_insert(object)))
    }
}

impl Host for Interpreter {
    fn pruner(&self, which: &Named) -> Result<Arc<dyn Pruner>> {
        Ok(Arc::new(Strategy { object: self.object("Pruner", which)?, named: which.clone() }))
    }

    fn initializer(&self, which: &Named) -> Result<Arc<dyn Initializer>> {
        Ok(Arc::new(Strategy { object: self.object("Initializer", which)?, named: which.clone() }))
    }

    fn split(&self, which: &Named) -> Result<Arc<dyn Split>> {
        Ok(Arc::new(Strategy { object: self.object("Split", which)?, named: which.clone() }))
    }

    fn baseline(&self, which: &Named) -> Result<Arc<dyn Baseline>> {
        Ok(Arc::new(Strategy { object: self.object("Baseline", which)?, named: which.clone() }))
    }

    fn metric(&self, which: &Named) -> Result<Arc<dyn Metric>> {
        Ok(Arc::new(Strategy { object: self.object("Metric", which)?, named: which.clone() }))
    }
}

impl Object {
    fn make(py: Python<'_>, kind: &str, which: &Named) -> PyResult<Self> {
        let helpers = py.import("pwrfgs._strategies")?;
        let Named { module, class, settings, source } = which;
        let own = helpers.getattr("made")?.call1((kind, module, class, settings, source))?;
        let has: BTreeSet<String> = helpers.getattr("overrides")?.call1((kind, &own))?.extract()?;
        let columns = if has.contains("columns") { columns(&own.call_method0("columns")?)? } else { Vec::new() };
        Ok(Self { own: own.unbind(), has, columns })
    }

    fn has(&self, method: &str) -> bool {
        self.has.contains(method)
    }
}

/// What a pruner asks for, as `Column`s.
fn columns(asked: &Bound<'_, PyAny>) -> PyResult<Vec<ColumnSpec>> {
    let one = |column: Bound<'_, PyAny>| {
        Ok(ColumnSpec {
            name: lasting(column.getattr("name")?.extract()?),
            width: column.getattr("width")?.extract()?,
            init: column.getattr("init")?.extract()?,
            learning_rate: column.getattr("learning_rate")?.extract()?,
            adam: column.getattr("adam")?.extract()?,
        })
    };
    asked.try_iter()?.map(|column| one(column?)).collect()
}

/// A name that lasts as long as the process; each once.
fn lasting(name: String) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = names.get(name.as_str()) {
        return known;
    }
    let name: &'static str = Box::leak(name.into_boxed_str());
    names.insert(name);
    name
}

/// A strategy in use. It is never written as text: what a pipeline holds is [`Named`].
#[derive(Debug)]
struct Strategy {
    object: Arc<Object>,
    named: Named,
}

impl Strategy {
    /// Does `work` with the object; an exception unwinds.
    fn with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> T {
        Python::attach(|py| work(py, self.object.own.bind(py))).unwrap_or_else(|error| throw(error))
    }

    /// The same where an exception is an error.
    fn try_with<T>(&self, work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>) -> Result<T> {
        Python::attach(|py| work(py, self.object.own.bind(py))).map_err(carried)
    }
}

/// Gaussians as the Python class `Cloud`: new arrays, which a strategy may keep; those of `update` may be written to.
pub(crate) fn cloud_object<'py>(py: Python<'py>, cloud: &GaussianCloud, writable: bool) -> PyResult<Bound<'py, PyAny>> {
    let columns = cloud.columns().map(|(name, _, values)| (name, values.to_vec()));
    columns_object(py, cloud.len(), columns, writable)
}

/// The same of Gaussians on the tape.
fn traced_object<'py>(py: Python<'py>, cloud: &Traced) -> PyResult<Bound<'py, PyAny>> {
    let columns = cloud.names().map(|name| (name, pwrfgs_core::tape::values(cloud.leaf(name))));
    columns_object(py, cloud.len(), columns, false)
}

fn columns_object<'py, 'a>(
    py: Python<'py>,
    n: usize,
    columns: impl Iterator<Item = (&'a str, Vec<Real>)>,
    writable: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let object = PyDict::new(py);
    for (name, values) in columns {
        // One number a Gaussian has no second axis.
        let width = values.len().checked_div(n).unwrap_or(1);
        let shape: &[usize] = if width <= 1 { &[n] } else { &[n, width] };
        let column = array(py, values, shape)?;
        if !writable {
            column.getattr("flags")?.setattr("writeable", false)?;
        }
        object.set_item(name, column)?;
    }
    py.import("pwrfgs._types")?.getattr("Cloud")?.call1((object,))
}

/// What was seen of the Gaussians, as the Python class `Stats`.
pub(crate) fn stats_object<'py>(py: Python<'py>, stats: &CloudStats) -> PyResult<Bound<'py, PyAny>> {
    let column = |values: &[Real]| array(py, values.to_vec(), &[values.len()]);
    let found = PyDict::new(py);
    let asked = &stats.asked;
    for (name, values) in [
        ("weight", &asked.weight),
        ("largest_weight", &asked.largest_weight),
        ("weight_per_area", &asked.weight_per_area),
        ("signal_mean", &asked.signal_mean),
        ("signal_max", &asked.signal_max),
        ("error", &asked.error),
        ("high_error", &asked.high_error),
        ("sensitivity", &asked.sensitivity),
        ("elimination", &asked.elimination),
    ] {
        if !values.is_empty() {
            found.set_item(name, column(values)?)?;
        }
    }
    if !asked.top.is_empty() {
        found.set_item("top", array(py, asked.top.clone(), &[asked.top.len()])?)?;
    }
    if !asked.fisher.is_empty() {
        let all: Vec<Real> = asked.fisher.as_flattened().to_vec();
        found.set_item("fisher", array(py, all, &[asked.fisher.len(), 21])?)?;
    }
    let fields = (
        column(&stats.visible)?,
        column(&stats.gradient)?,
        column(&stats.radius)?,
        column(&stats.weight)?,
        found,
        column(&stats.state)?,
    );
    py.import("pwrfgs._types")?.getattr("Stats")?.call1(fields)
}

fn moment_object<'py>(py: Python<'py>, moment: &Moment) -> PyResult<Bound<'py, PyAny>> {
    let Moment { step, phase, seed, round, rounds } = *moment;
    py.import("pwrfgs._types")?.getattr("Moment")?.call1((step, phase.name(), seed, round, rounds))
}

/// The names of statistics that a pruner may ask for.
fn statistic(name: &str) -> Option<Statistic> {
    Some(match name {
        "weight" => Statistic::Weight,
        "largest_weight" => Statistic::LargestWeight,
        "weight_per_area" => Statistic::WeightPerArea,
        "signal_weight" => Statistic::SignalWeight,
        "error" => Statistic::Error { high: 0.5 },
        "top" => Statistic::Top { count: 1 },
        "sensitivity" => Statistic::Sensitivity,
        "fisher" => Statistic::Fisher,
        "elimination" => Statistic::Elimination { most: 4_096 },
        _ => return None,
    })
}

const STATISTICS: [&str; 9] = [
    "weight",
    "largest_weight",
    "weight_per_area",
    "signal_weight",
    "error",
    "top",
    "sensitivity",
    "fisher",
    "elimination",
];

/// The derivatives that come with a gate or a penalty: of each column that is named.
struct Slopes {
    columns: Vec<Trace>,
    slopes: Vec<Vec<Real>>,
}

impl Slopes {
    fn of(given: &Bound<'_, PyAny>, cloud: &Traced, what: &str) -> PyResult<Self> {
        let (mut columns, mut slopes) = (Vec::new(), Vec::new());
        for item in given.cast::<PyDict>().map_err(PyErr::from)?.iter() {
            let (name, values): (String, _) = (item.0.extract()?, item.1);
            if !cloud.names().any(|own| own == name) {
                let hint = pwrfgs_core::did_you_mean(&name, cloud.names());
                return Err(wrong(given.py(), &format!("{what}: there is no column `{name}`{hint}")));
            }
            let trace = cloud.column(&name);
            let length = pwrfgs_core::tape::values(cloud.leaf(&name)).len();
            let flat = given_flat(&format!("{what}: the derivative in `{name}`"), &values, length)?;
            columns.push(trace);
            slopes.push(flat);
        }
        if columns.is_empty() {
            return Err(wrong(given.py(), &format!("{what}: give the derivative in one column at least")));
        }
        Ok(Self { columns, slopes })
    }
}

/// Numbers of any shape, `length` in all.
fn given_flat(what: &str, values: &Bound<'_, PyAny>, length: usize) -> PyResult<Vec<Real>> {
    let array = given::<Real>(what, values, &vec![None; axes(values)?])?;
    let all = array.as_slice().map_err(|e| wrong(values.py(), &e.to_string()))?;
    if all.len() == length && all.iter().all(|v| v.is_finite()) {
        return Ok(all.to_vec());
    }
    let found = all.len();
    Err(wrong(values.py(), &format!("{what} has {found} numbers, and {length} finite ones are wanted")))
}

// What a pipeline holds is `Named`; these two are never written or read.
impl pwrfgs::prelude::Serialize for Strategy {
    fn serialize<S: serde::Serializer>(&self, s: S) -> std::result::Result<S::Ok, S::Error> {
        self.named.serialize(s)
    }
}

impl Pruner for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        self.with(|py, own| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, moment_object(py, moment)?);
            let keep = own.call_method1("keep", arguments)?;
            numbers::<bool>("what keep gave", &keep, &[Some(cloud.len())])
        })
    }

    fn needs(&self, cloud: &GaussianCloud, moment: &Moment) -> Needs {
        if !self.object.has("needs") {
            return Needs::nothing();
        }
        self.with(|py, own| {
            let asked = own.call_method1("needs", (cloud_object(py, cloud, false)?, moment_object(py, moment)?))?;
            let mut needs = Needs::nothing();
            for name in asked.try_iter()? {
                let name: String = name?.extract()?;
                let Some(statistic) = statistic(&name) else {
                    let hint = pwrfgs_core::did_you_mean(&name, STATISTICS);
                    let what =
                        format!("needs: there is no statistic `{name}`{hint} (there are {})", STATISTICS.join(", "));
                    return Err(wrong(py, &what));
                };
                needs.statistics.push(statistic);
            }
            Ok(needs)
        })
    }

    fn columns(&self) -> Vec<ColumnSpec> {
        self.object.columns.clone()
    }

    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        if !self.object.has("gate") {
            return None;
        }
        self.with(|py, own| {
            let arguments = (traced_object(py, cloud)?, moment_object(py, moment)?);
            let found = own.call_method1("gate", arguments)?;
            if found.is_none() {
                return Ok(None);
            }
            let parts = found.cast::<PyTuple>().map_err(PyErr::from)?;
            let factor = given_flat("the gate", &parts.get_item(0)?, cloud.len())?;
            let Slopes { columns, slopes } = Slopes::of(&parts.get_item(1)?, cloud, "gate")?;
            let n = cloud.len();
            let vjp = move |cotangents: Vec<Vec<Real>>| {
                let rows = |slopes: &Vec<Real>| {
                    let width = slopes.len().checked_div(n).unwrap_or(1).max(1);
                    slopes.iter().enumerate().map(|(k, slope)| slope * cotangents[0][k / width]).collect()
                };
                slopes.iter().map(rows).collect()
            };
            let gate = op(columns, vec![factor], vjp).remove(0);
            let presence = parts.len() > 2 && parts.get_item(2)?.extract::<String>()? == "presence";
            Ok(Some(if presence { Gate::Presence(gate) } else { Gate::Whole(gate) }))
        })
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        if !self.object.has("penalty") {
            return None;
        }
        self.with(|py, own| {
            let arguments = (traced_object(py, cloud)?, moment_object(py, moment)?);
            let found = own.call_method1("penalty", arguments)?;
            if found.is_none() {
                return Ok(None);
            }
            let (value, slopes): (Real, Bound<'_, PyAny>) = found.extract()?;
            let Slopes { columns, slopes } = Slopes::of(&slopes, cloud, "penalty")?;
            let vjp = move |cotangents: Vec<Vec<Real>>| {
                slopes.iter().map(|slopes| slopes.iter().map(|slope| slope * cotangents[0][0]).collect()).collect()
            };
            Ok(Some(op(columns, vec![vec![value]], vjp).remove(0).sum()))
        })
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, moment: &Moment) {
        if !self.object.has("update") {
            return;
        }
        self.with(|py, own| {
            let object = cloud_object(py, cloud, true)?;
            own.call_method1("update", (&object, stats_object(py, stats)?, moment_object(py, moment)?))?;
            let columns = object.getattr("columns")?;
            for (name, _, values) in cloud.columns_mut() {
                let column = columns.get_item(name)?;
                values.copy_from_slice(&given_flat(&format!("update: `{name}`"), &column, values.len())?);
            }
            Ok(())
        });
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<Real> {
        if !self.object.has("score") {
            return cloud.opacity_logits.clone();
        }
        self.with(|py, own| {
            let arguments = (cloud_object(py, cloud, false)?, stats_object(py, stats)?, moment_object(py, moment)?);
            given_flat("the score", &own.call_method1("score", arguments)?, cloud.len())
        })
    }

    fn state(&self) -> Option<Vec<Real>> {
        let has = self.object.has("state");
        has.then(|| self.with(|_, own| numbers::<Real>("state", &own.call_method0("state")?, &[None])))
    }

    fn advance(&self, state: &mut [Real], n: usize, cloud: &GaussianCloud, moment: &Moment) {
        if !self.object.has("advance") {
            return;
        }
        self.with(|py, own| {
            let before = array(py, state.to_vec(), &[state.len()])?;
            let arguments = (before, n, cloud_object(py, cloud, false)?, moment_object(py, moment)?);
            let after = own.call_method1("advance", arguments)?;
            state.copy_from_slice(&numbers::<Real>("what advance gave", &after, &[Some(state.len())])?);
            Ok(())
        });
    }
}

/// A generator of NumPy's that follows from the run's own.
fn generator<'py>(py: Python<'py>, random: &mut rng::Rng) -> PyResult<Bound<'py, PyAny>> {
    py.import("numpy.random")?.call_method1("default_rng", (rng::below(random, 1 << 62),))
}

impl Initializer for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn initialize(&self, scene: &Scene, _: &ImagePlane, random: &mut rng::Rng) -> Result<GaussianCloud> {
        self.try_with(|py, own| {
            let world = |place: &[Real; 3]| scene.origin.world(*place);
            let points: Vec<f64> = scene.points.iter().flat_map(world).collect();
            let receivers: Vec<f64> =
                scene.receivers.iter().flat_map(|receiver| scene.origin.world_pose(receiver.pose).position).collect();
            let arguments = (
                array(py, points, &[scene.points.len(), 3])?,
                array(py, [world(&scene.bounds.0), world(&scene.bounds.1)].concat(), &[2, 3])?,
                array(py, receivers, &[scene.receivers.len(), 3])?,
            );
            let scene_object = py.import("pwrfgs._types")?.getattr("Room")?.call1(arguments)?;
            let found = own.call_method1("initialize", (scene_object, generator(py, random)?))?;
            let found = found.cast::<PyDict>().map_err(PyErr::from)?;
            start(found, scene)
        })
    }
}

/// A cloud from means, scales and whatever else is given.
fn start(found: &Bound<'_, PyDict>, scene: &Scene) -> PyResult<GaussianCloud> {
    let py = found.py();
    let need = |name: &str| {
        found
            .get_item(name)?
            .ok_or_else(|| wrong(py, &format!("initialize gave no `{name}`; means [N, 3] and scales are needed")))
    };
    let means = crate::arrays::places("means", &need("means")?)?;
    let n = means.len();
    let scales = need("scales")?;
    let scales: Vec<[Real; 3]> = match axes(&scales)? {
        0 => vec![[scales.extract()?; 3]; n],
        1 => numbers::<Real>("scales", &scales, &[Some(n)])?.into_iter().map(|s| [s; 3]).collect(),
        _ => numbers::<Real>("scales", &scales, &[Some(n), Some(3)])?.as_chunks().0.to_vec(),
    };
    if !scales.as_flattened().iter().all(|s| s.is_finite() && *s > 0.0) {
        return Err(wrong(py, "scales: give metres above 0"));
    }
    let opacities = match found.get_item("opacities")? {
        None => vec![0.1; n],
        Some(given) if axes(&given)? == 0 => vec![given.extract()?; n],
        Some(given) => numbers::<Real>("opacities", &given, &[Some(n)])?,
    };
    if !opacities.iter().all(|o| *o > 0.0 && *o < 1.0) {
        return Err(wrong(py, "opacities: give numbers between 0 and 1"));
    }
    let quats = match found.get_item("quats")? {
        None => vec![[1.0, 0.0, 0.0, 0.0]; n],
        Some(given) => numbers::<Real>("quats", &given, &[Some(n), Some(4)])?.as_chunks().0.to_vec(),
    };
    let signals = match found.get_item("signals")? {
        None => vec![[0.0; 2]; n],
        Some(given) => numbers::<Gain>("signals", &given, &[Some(n)])?.iter().map(|s| [s.re, s.im]).collect(),
    };
    Ok(GaussianCloud {
        means: means.iter().map(|mean| scene.origin.local(*mean)).collect(),
        log_scales: scales.iter().map(|s| s.map(Real::ln)).collect(),
        quats,
        opacity_logits: opacities.into_iter().map(logit).collect(),
        signals,
        extra: Vec::<ExtraColumn>::new(),
    })
}

impl Split for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn split(&self, data: &Dataset, random: &mut rng::Rng) -> Result<Partition> {
        let count = data.len();
        let lists = self.try_with(|py, own| {
            let links = links_object(py, data, &(0..count).collect::<Vec<_>>())?;
            let found = own.call_method1("split", (links, generator(py, random)?))?;
            let lists = found.try_iter()?.map(|part| part_of(&part?, count)).collect::<PyResult<Vec<_>>>()?;
            match lists.len() {
                2 | 3 => Ok(lists),
                n => Err(wrong(py, &format!("split gave {n} parts; give (train, test) or (train, validation, test)"))),
            }
        })?;
        let mut lists = lists.into_iter();
        let train = lists.next().unwrap_or_default();
        let (validation, test) = match (lists.next(), lists.next()) {
            (Some(validation), Some(test)) => (validation, test),
            (Some(test), None) => (Vec::new(), test),
            _ => Default::default(),
        };
        let mut all: Vec<usize> = [&train, &validation, &test].into_iter().flatten().copied().collect();
        all.sort_unstable();
        let twice = all.windows(2).find_map(|pair| (pair[0] == pair[1]).then(|| pair[0]));
        if let Some(twice) = twice {
            return Err(Error::Config(format!("split: link {twice} is in two parts")));
        }
        Ok(Partition { train, validation, test })
    }
}

/// Places of links, sorted, from a mask or from places.
fn part_of(part: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<usize>> {
    if let Ok(mask) = numbers::<bool>("a part", part, &[Some(count)]) {
        return Ok((0..count).filter(|&i| mask[i]).collect());
    }
    let places = numbers::<i64>("a part", part, &[None])?;
    if let Some(bad) = places.iter().find(|i| usize::try_from(**i).is_err() || **i as usize >= count) {
        return Err(wrong(part.py(), &format!("split: there is no link {bad}; there are {count}, counted from 0")));
    }
    let mut places: Vec<usize> = places.into_iter().map(|i| i as usize).collect();
    places.sort_unstable();
    Ok(places)
}

/// Links without what was observed of them, as the Python class `Links`.
fn links_object<'py>(py: Python<'py>, data: &Dataset, links: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let rows: Vec<_> = links.iter().map(|&i| data.sample(i)).collect();
    let fields = (
        array(py, rows.iter().flat_map(|s| s.tx).collect::<Vec<f64>>(), &[rows.len(), 3])?,
        array(py, rows.iter().map(|s| i64::from(s.id)).collect::<Vec<i64>>(), &[rows.len()])?,
        array(py, rows.iter().map(|s| s.receiver as i64).collect::<Vec<i64>>(), &[rows.len()])?,
    );
    py.import("pwrfgs._types")?.getattr("Links")?.call1(fields)
}

impl Baseline for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn name(&self) -> String {
        self.with(|_, own| match own.getattr("name") {
            Ok(name) => name.extract(),
            Err(_) => Ok(self.named.class.clone()),
        })
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        let own = self.try_with(|py, own| {
            let links = known.all();
            let seen = crate::data::observed(py, data, &links)?;
            let predictor = own.call_method1("fit", (links_object(py, data, &links)?, seen))?;
            Ok(if predictor.is_none() { own.clone().unbind() } else { predictor.unbind() })
        })?;
        Ok(Box::new(Predictor { own, kind: data.kind(), size: (data.width, data.height) }))
    }
}

/// What a baseline of Python's predicts with.
struct Predictor {
    own: Py<PyAny>,
    kind: Kind,
    size: (usize, usize),
}

impl Predict for Predictor {
    fn predict(&self, query: Query<'_>) -> Image {
        let (width, height) = self.size;
        let asked = |py: Python<'_>| {
            let tx = array(py, query.tx.to_vec(), &[3])?;
            let found = self.own.bind(py).call_method1("predict", (tx, query.receiver))?;
            let what = "what predict gave";
            let pixels = match self.kind {
                Kind::Spectrum => numbers::<Real>(what, &found, &[Some(height), Some(width)])?,
                Kind::Power => vec![found.extract::<Real>()?],
                Kind::Channel => {
                    let gains = numbers::<Gain>(what, &found, &[Some(height / 2), Some(width)])?;
                    rows_of(&gains.iter().map(|gain| [gain.re, gain.im]).collect::<Vec<_>>(), width)
                }
            };
            Ok(Image { width, height, pixels })
        };
        Python::attach(asked).unwrap_or_else(|error: PyErr| throw(error))
    }
}

impl Metric for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        self.try_with(|py, own| {
            let stack = |images: &[Image]| stacked(py, images, evaluation.kind);
            let found = own.call_method1("evaluate", (stack(evaluation.predictions)?, stack(evaluation.truths)?))?;
            let text = |name: &str, none: &str| match own.getattr(name) {
                Ok(own) => own.extract::<String>(),
                Err(_) => Ok(none.to_owned()),
            };
            let higher = own.getattr("higher_is_better").map_or(Ok(true), |own| own.extract::<bool>())?;
            let values = if axes(&found)? == 0 {
                Values::Whole(found.extract()?)
            } else {
                Values::PerSample(numbers::<f64>("what evaluate gave", &found, &[Some(evaluation.truths.len())])?)
            };
            let unit = text("unit", "")?;
            Ok(vec![Measurement {
                key: text("name", &self.named.class)?,
                unit: if unit.is_empty() { "" } else { lasting(unit) },
                goal: if higher { Goal::Higher } else { Goal::Lower },
                values,
            }])
        })
    }
}

/// Observations as one array.
fn stacked<'py>(py: Python<'py>, images: &[Image], kind: Kind) -> PyResult<Bound<'py, PyAny>> {
    let (count, all) = (images.len(), images.iter().flat_map(|image| image.pixels.iter().copied()));
    let (height, width) = images.first().map_or((0, 0), |image| (image.height, image.width));
    match kind {
        Kind::Spectrum => array(py, all.collect::<Vec<Real>>(), &[count, height, width]).map(Bound::into_any),
        Kind::Power => array(py, all.collect::<Vec<Real>>(), &[count]).map(Bound::into_any),
        Kind::Channel => {
            let gains: Vec<Gain> = images.iter().flat_map(|image| complex(&gains_of(&image.pixels, width))).collect();
            array(py, gains, &[count, height / 2, width]).map(Bound::into_any)
        }
    }
}
