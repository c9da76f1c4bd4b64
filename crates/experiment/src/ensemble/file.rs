//! `EnsembleFile`: several pipelines whose models predict together, as one RON file.

use super::Team;
use crate::input::{absolute, read_base, rebase, set_all};
use crate::sweep::{check_name, check_seeds};
use pwrfgs_core::docs::Kind;
use pwrfgs_core::plugin::{Check, Checked, ron_options};
use pwrfgs_core::{Documented, Error, Result, plugin::read_ron};
use pwrfgs_pipeline::{Draft, Pipeline, PipelinePatch};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Several models of one scene: each is trained as a run of its own, and the mean of their pictures is one predictor.
///
/// `pwrfgs run` reads such a file as it reads a pipeline. Members may differ in everything but data, split and projector;
/// baselines and metrics are those of the first.
///
/// ```
/// # use pwrfgs_experiment::ensemble::EnsembleFile;
/// let text = r#"Ensemble(
///     name: "both-kinds",
///     seeds: [0, 1],                                     // every member with each of these: four models
///     set: (training: (scale: 0.5)),                     // for all members
///     members: [
///         Member(base: "../pipelines/s23-laptop.ron"),   // relative to this file
///         Member(base: "../pipelines/s23-array.ron", label: "waves", set: (training: (batch: 32))),
///     ],
/// )"#;
/// assert_eq!(EnsembleFile::parse(text, "both-kinds.ron".as_ref()).unwrap().name, "both-kinds");
/// ```
#[derive(Clone, Debug, Deserialize, Documented)]
#[serde(rename = "Ensemble", deny_unknown_fields)]
pub struct EnsembleFile {
    /// Names the run folder: letters, digits, `.`, `-` and `_`.
    pub name: String,
    /// Who takes part: `Member(base: "other.ron")`, or a whole `Pipeline(..)`.
    pub members: Vec<MemberFile>,
    /// Every member is trained with each of these; left out, with the seed that its pipeline has.
    #[serde(default)]
    pub seeds: Option<Vec<u64>>,
    /// Fields of a pipeline for all members.
    #[serde(default)]
    pub set: PipelinePatch,
}

/// One entry of `members`.
#[derive(Clone, Debug, Deserialize)]
pub enum MemberFile {
    /// A pipeline as it stands.
    Pipeline(Box<Pipeline>),
    /// Another file's pipeline, changed.
    Member(Box<Member>),
}

/// A member of an ensemble that starts from a pipeline file.
#[derive(Clone, Debug, Deserialize, Documented)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// The pipeline file, relative to that of the ensemble.
    pub base: PathBuf,
    /// What it is called; left out, as its pipeline is.
    #[serde(default)]
    pub label: Option<String>,
    /// Fields of a pipeline that change, those of all members first.
    #[serde(default)]
    pub set: PipelinePatch,
}

impl Documented for MemberFile {
    fn kind() -> Kind {
        Kind::Plain("`Member(..)` or `Pipeline(..)`")
    }
}

/// How an ensemble is written into its folder: every member whole.
#[derive(Serialize)]
#[serde(rename = "Ensemble")]
pub(super) struct Written<'a> {
    pub(super) name: &'a str,
    pub(super) members: Vec<WrittenMember<'a>>,
}

/// As [`MemberFile::Pipeline`].
#[derive(Serialize)]
pub(super) enum WrittenMember<'a> {
    Pipeline(&'a Pipeline),
}

impl Check for EnsembleFile {
    fn check(&self) -> Result<(), String> {
        let Self { name, seeds, set, members } = self;
        check_name(name)?;
        seeds.as_deref().map_or(Ok(()), check_seeds)?;
        let patches = members.iter().filter_map(|member| match member {
            MemberFile::Pipeline(_) => None,
            MemberFile::Member(member) => Some(&member.set),
        });
        if [set]
            .into_iter()
            .chain(patches)
            .any(|set| ["label", "name", "seed", "split_seed"].iter().any(|f| set.gives(f)))
        {
            return Err("`set` cannot give `label`, `name`, `seed` or `split_seed`: seeds stand in `seeds`".into());
        }
        Ok(())
    }
}

impl EnsembleFile {
    /// Reads an ensemble; `path` is for messages only.
    ///
    /// # Errors
    /// [`Error::Input`] with line and column.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        read_ron::<Checked<Self>>(text, path).map(|e| Self::clone(&e))
    }

    /// All members as they are trained; `set` holds `--set` arguments, which change every member and win; `seeds=[2, 3]`
    /// among them takes the place of the file's.
    ///
    /// # Errors
    /// Whatever is wrong with a member, by its name, or with an argument.
    pub(crate) fn resolve(mut self, path: &Path, set: &[String]) -> Result<Team> {
        let of_all = |argument: &&String| argument.split('=').next().is_some_and(|field| field.trim() == "seeds");
        if let Some(argument) = set.iter().rfind(of_all) {
            let value = argument.split_once('=').map_or("", |(_, value)| value);
            let seeds: Vec<u64> = ron_options()
                .from_str(value)
                .map_err(|e| Error::Config(format!("--set {argument}: {}; write it as seeds=[0, 1]", e.code)))?;
            self.seeds = Some(seeds);
            self.check().map_err(|why| Error::Config(format!("--set {argument}: {why}")))?;
        }
        let set: Vec<String> = set.iter().filter(|argument| !of_all(argument)).cloned().collect();
        let mut members = Vec::new();
        for member in &self.members {
            let pipeline = self.member(member, path)?;
            let pipeline = changed(&pipeline, &set)?;
            let named = |e: Error| Error::input(path, format!("member `{}`: {e}", pipeline.name));
            match self.seeds.as_deref() {
                None => members.push(pipeline.resolved().map_err(named)?),
                Some(seeds) => {
                    for &seed in seeds {
                        let name =
                            if seeds.len() == 1 { pipeline.name.clone() } else { format!("{}-{seed}", pipeline.name) };
                        members.push(Pipeline { name, seed, ..pipeline.clone() }.resolved().map_err(named)?);
                    }
                }
            }
        }
        Team::new(self.name, members).map_err(|why| Error::input(path, why))
    }

    /// One member, before `--set`.
    fn member(&self, member: &MemberFile, path: &Path) -> Result<Pipeline> {
        let here = path.parent().unwrap_or(Path::new(""));
        let (base, label, own) = match member {
            MemberFile::Pipeline(pipeline) => {
                let mut pipeline = Pipeline::clone(pipeline);
                rebase(&mut pipeline, here);
                (pipeline, None, None)
            }
            MemberFile::Member(member) => {
                let Member { base, label, set } = &**member;
                (read_base(&here.join(base))?, label.as_deref(), Some(set))
            }
        };
        let mut draft = Draft::of(&base);
        for patch in [Some(&self.set), own].into_iter().flatten() {
            let of = |e: Error| Error::input(path, format!("member `{}`: set: {e}", base.name));
            draft.merge(patch).map_err(of)?;
            if patch.gives("data") || patch.gives("baselines") {
                draft.rebase(&|path| absolute(here, path)).map_err(of)?;
            }
        }
        let of = |e: Error| Error::input(path, format!("member `{}`: set: {e}", label.unwrap_or(&base.name)));
        if let Some(label) = label {
            draft.set("name", &format!("{label:?}")).map_err(of)?;
        }
        draft.finish().map_err(of)
    }
}

/// A member with `--set` arguments.
fn changed(pipeline: &Pipeline, set: &[String]) -> Result<Pipeline> {
    let mut own = pipeline.clone();
    set_all(&mut own, set)?;
    if (&own.name, own.seed, own.split_seed) != (&pipeline.name, pipeline.seed, pipeline.split_seed) {
        let why = "an ensemble names and seeds its members itself; give --set 'seeds=[0, 1]', or change its file";
        return Err(Error::Config(format!("--set: {why}")));
    }
    Ok(own)
}
