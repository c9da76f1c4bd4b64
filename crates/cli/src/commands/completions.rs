//! `pwrfgs completions` and `pwrfgs man`: completion scripts and manual pages, generated from the command line.

use crate::output;
use clap::{Args, Command};
use clap_complete::Shell;
use pwrfgs_core::{Error, Result, files};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
EXAMPLES
  pwrfgs completions bash > ~/.local/share/bash-completion/completions/pwrfgs
  pwrfgs completions fish > ~/.config/fish/completions/pwrfgs.fish
  pwrfgs completions zsh > ~/.zfunc/_pwrfgs   # needs `fpath+=~/.zfunc` before compinit in ~/.zshrc")]
pub(crate) struct Completions {
    /// Shell
    #[arg(value_name = "SHELL")]
    pub(crate) shell: Shell,
}

#[derive(Debug, Args)]
#[command(after_help = "\
EXAMPLES
  pwrfgs man | man -l -
  pwrfgs man --out ~/.local/share/man/man1    # then: man pwrfgs-run")]
pub(crate) struct Man {
    /// Folder for pwrfgs.1 and a page per command [default: print pwrfgs.1]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Runs `pwrfgs completions`.
pub(crate) fn completions(arguments: &Completions, mut program: Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, "pwrfgs", &mut script);
    output::result(&String::from_utf8_lossy(&script))
}

/// Runs `pwrfgs man`.
pub(crate) fn man(arguments: &Man, mut command: Command) -> Result<()> {
    command.build();
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |e| Error::write(&path, e)
    };
    let Some(folder) = &arguments.out else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page).map_err(failed(Path::new("the page")))?;
        return output::result(&String::from_utf8_lossy(&page));
    };
    pwrfgs_core::files::check_path(folder)?;
    let mut pages = Vec::new();
    for page in std::iter::once(&command).chain(command.get_subcommands().filter(|c| c.get_name() != "help")) {
        let man = clap_mangen::Man::new(page.clone());
        let path = folder.join(man.get_filename());
        refuse_other_file(&path)?;
        let mut text = Vec::new();
        man.render(&mut text).map_err(failed(&path))?;
        pages.push((path, text));
    }
    std::fs::create_dir_all(folder).map_err(failed(folder))?;
    pages.iter().try_for_each(|(path, text)| files::write_atomically(path, text))
}

/// Rejects an existing file unless it is an earlier version of the same page, by its title.
fn refuse_other_file(path: &Path) -> Result<()> {
    let Ok(metadata) = path.symlink_metadata() else { return Ok(()) };
    let title = format!(".TH {} ", path.file_stem().unwrap_or_default().display());
    let is_title = |text: String| text.lines().any(|line| line.starts_with(&title));
    if metadata.is_file() && files::read_string(path).is_ok_and(is_title) {
        return Ok(());
    }
    Err(Error::input(path, "not a manual page of pwrfgs, and not replaced; choose another --out or move the file"))
}
