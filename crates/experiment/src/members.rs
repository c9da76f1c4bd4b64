//! Several models of one run: each is trained without a fold of the known links, and their mean predicts.

use crate::facts::Facts;
use crate::folder::{MODEL_FILE, member_folder};
use crate::load::{ActiveRun, SplitData};
use crate::run_folder::RunFolder;
use crate::training::new_trainer;
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, Model, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{Trainer, check_available};
use std::time::Instant;

impl SplitData {
    /// Returns the same data, split for one model of a run.
    ///
    /// # Errors
    /// As [`Pipeline::partition`].
    pub(crate) fn of_member(&self, member: &Pipeline) -> Result<Self> {
        Ok(Self { data: self.data.clone(), partition: member.partition(&self.data)? })
    }
}

impl ActiveRun<'_, '_> {
    /// Checks what the training of all models needs, on the first of them, before files are written.
    ///
    /// # Errors
    /// Invalid settings, too few known links for the folds, or too little memory.
    pub(crate) fn check_members(&self) -> Result<()> {
        let (member, data) = (self.pipeline.member(0), &self.split.data);
        check_available(&member.pruners)?;
        let partition = member.partition(data)?;
        new_trainer(&member, || Trainer::sketch(&member.plan()?, data, &partition)).map(drop)
    }

    /// Trains the models of the run, each in its folder, and writes their ensemble. Models of earlier starts are read or
    /// resumed. `facts` gets the sums over all models. Returns `None` if stopped.
    ///
    /// # Errors
    /// As [`crate::run`].
    pub(crate) fn train_members(&mut self, folder: &RunFolder, facts: &mut Facts) -> Result<Option<Ensemble>> {
        let count = self.pipeline.members;
        let mut models = Vec::new();
        for index in 0..count {
            let member = self.pipeline.member(index);
            let split = self.split.of_member(&member)?;
            self.session.observer.on_message(&format!("model {} of {count}", index + 1));
            let mut run = ActiveRun { pipeline: &member, split: &split, session: self.session, begun: Instant::now() };
            let mut claimed = RunFolder::claim(&folder.name().join(member_folder(index)), &member)?;
            match run.train_member(&mut claimed) {
                Ok(Some(model)) => models.push(((index + 1).to_string(), model)),
                Ok(None) | Err(Error::Stopped) => break,
                Err(error) => return Err(error),
            }
        }
        facts.sum_members((0..count).map(|index| folder.file(&member_folder(index))))?;
        facts.wall_seconds += self.begun.elapsed().as_secs_f64();
        facts.write(folder.path())?;
        if models.len() < count {
            return Ok(None);
        }
        let ensemble = Ensemble::named(models).map_err(Error::Config)?;
        file::write_ensemble(&folder.file(MODEL_FILE), &ensemble)?;
        Ok(Some(ensemble))
    }

    /// Trains one model in its folder, or reads the model of an earlier start; `None` if stopped.
    fn train_member(&mut self, folder: &mut RunFolder) -> Result<Option<Model>> {
        let path = folder.file(MODEL_FILE);
        if path.is_file() {
            return file::read(&path).map(Some);
        }
        let trainer = self.start_trainer(Some(folder))?;
        let mut facts = folder.begin(self.pipeline, self.split, Facts::default())?;
        self.train(trainer, folder, &mut facts)
    }
}
