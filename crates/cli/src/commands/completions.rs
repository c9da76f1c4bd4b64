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
    /// Shell that the script is for
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
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Runs `pwrfgs completions`: prints the script for a shell.
pub(crate) fn print_completions(arguments: &Completions, mut program: Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, "pwrfgs", &mut script);
    output::print_result(&String::from_utf8_lossy(&script))
}

/// Runs `pwrfgs man`: prints the page of the program, or writes the pages of all commands. It writes nothing if one of
/// them would replace another file.
pub(crate) fn write_manual(arguments: &Man, mut command: Command) -> Result<()> {
    command.build();
    let Some(folder) = &arguments.out else {
        let mut page = Vec::new();
        clap_mangen::Man::new(command).render(&mut page).map_err(|e| Error::write(Path::new("the page"), e))?;
        return output::print_result(&String::from_utf8_lossy(&page));
    };
    files::check_path(folder)?;
    let mut pages = Vec::new();
    for page in std::iter::once(&command).chain(command.get_subcommands().filter(|c| c.get_name() != "help")) {
        let man = clap_mangen::Man::new(page.clone());
        let path = folder.join(man.get_filename());
        check_replaceable(&path)?;
        let mut text = Vec::new();
        man.render(&mut text).map_err(|e| Error::write(&path, e))?;
        pages.push((path, text));
    }
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    pages.iter().try_for_each(|(path, text)| files::write_atomically(path, text))
}

/// Rejects an existing file, except an earlier version of the same manual page, which its title shows.
fn check_replaceable(path: &Path) -> Result<()> {
    let Ok(metadata) = path.symlink_metadata() else { return Ok(()) };
    let title = format!(".TH {} ", path.file_stem().unwrap_or_default().display());
    let is_title = |text: String| text.lines().any(|line| line.starts_with(&title));
    if metadata.is_file() && files::read_string(path).is_ok_and(is_title) {
        return Ok(());
    }
    Err(Error::input(path, "not a manual page of pwrfgs, and not replaced; choose another --out or move the file"))
}
