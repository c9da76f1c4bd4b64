//! `Recipe`: what a file asks for, one model or several that predict together.

use crate::ensemble::{EnsembleFile, Team};
use crate::input::{parse_base, set_all};
use pwrfgs_core::{Result, files::read_text};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// A pipeline, or an ensemble of them.
#[derive(Clone, Debug)]
pub enum Recipe {
    /// `Pipeline(..)`.
    Pipeline(Box<Pipeline>),
    /// `Ensemble(..)`.
    Ensemble(Team),
}

impl Recipe {
    /// Reads the file in `path`, applies `--set` arguments (to every member of an ensemble) and then `training.scale`.
    /// Paths in the file are relative to the file.
    ///
    /// # Errors
    /// [`Error::Input`](pwrfgs_core::Error::Input) with line and column, or what is wrong with an argument.
    pub fn read(path: &Path, set: &[String]) -> Result<Self> {
        Self::parse(&read_text(path)?, path, set)
    }

    /// [`Self::read`] of text that was read from `path`.
    pub(crate) fn parse(text: &str, path: &Path, set: &[String]) -> Result<Self> {
        if is_ensemble(text) {
            return EnsembleFile::parse(text, path)?.resolve(path, set).map(Self::Ensemble);
        }
        let mut pipeline = parse_base(text, path)?;
        set_all(&mut pipeline, set)?;
        Ok(Self::Pipeline(Box::new(pipeline.resolved()?)))
    }

    /// What the model is scored by: data, split, baselines and metrics, under its own name.
    pub fn pipeline(&self) -> Pipeline {
        match self {
            Self::Pipeline(pipeline) => Pipeline::clone(pipeline),
            Self::Ensemble(team) => team.pipeline(),
        }
    }

    /// As RON text, every default written out; [`Self::read`] gives the same back.
    pub fn to_ron(&self) -> String {
        match self {
            Self::Pipeline(pipeline) => pipeline.to_ron(),
            Self::Ensemble(team) => team.text().unwrap_or_else(|why| format!("// {why}")) + "\n",
        }
    }

    /// The seed of a pipeline, or those of all members.
    pub fn seeds(&self) -> Vec<u64> {
        match self {
            Self::Pipeline(pipeline) => vec![pipeline.seed],
            Self::Ensemble(team) => team.members().iter().map(|member| member.seed).collect(),
        }
    }

    /// Equal for recipes that differ in names and in the seeds of training alone.
    pub fn variant_key(&self) -> String {
        let nameless = |pipeline: &Pipeline| Pipeline { name: String::new(), seed: 0, ..pipeline.clone() };
        match self {
            Self::Pipeline(pipeline) => nameless(pipeline).to_ron(),
            Self::Ensemble(team) => {
                let member = |member: &Pipeline| Pipeline { split_seed: None, ..nameless(member) }.to_ron();
                team.members().iter().map(member).collect()
            }
        }
    }

    /// The same with the baselines and metrics of `other`: these are not part of what is trained.
    pub(crate) fn scored_as(&self, other: &Self) -> Self {
        let scored = |own: &Pipeline, other: &Pipeline| Pipeline {
            baselines: other.baselines.clone(),
            metrics: other.metrics.clone(),
            ..own.clone()
        };
        match (self, other) {
            (Self::Pipeline(own), Self::Pipeline(other)) => Self::Pipeline(Box::new(scored(own, other))),
            (Self::Ensemble(own), Self::Ensemble(other)) => Self::Ensemble(own.zipped(other, scored)),
            _ => self.clone(),
        }
    }

    /// The same without what changes nothing of the result.
    pub(crate) fn essential(&self) -> Self {
        match self {
            Self::Pipeline(pipeline) => Self::Pipeline(Box::new(pipeline.essential())),
            Self::Ensemble(team) => Self::Ensemble(team.essential()),
        }
    }
}

/// By the first word: a parser then says what is wrong with the rest.
fn is_ensemble(text: &str) -> bool {
    let mut rest = text.trim_start();
    while let Some(comment) = rest.strip_prefix("//").or_else(|| rest.strip_prefix("/*")) {
        let end = if rest.starts_with("//") { "\n" } else { "*/" };
        rest = comment.split_once(end).map_or("", |(_, rest)| rest).trim_start();
    }
    rest.starts_with("Ensemble")
}
