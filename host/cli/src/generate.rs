//! `sutura completions` and `sutura man`: what shells and `man` need to know of this command, made of its arguments.
//!
//! Entry points: [`completions`], [`man`].

use crate::failure::{Cause, Failure};
use crate::files::unwritable;
use clap::{Args, Command};
use clap_complete::Shell;
use std::io::Write;
use std::path::PathBuf;

/// Prints a script that lets a shell complete commands and options.
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
pub struct CompletionsArgs {
    /// Which shell.
    #[arg(value_enum)]
    pub shell: Shell,
}

const COMPLETIONS: &str = "\
Examples:
  sutura completions bash > ~/.local/share/bash-completion/completions/sutura
  sutura completions zsh > ~/.zfunc/_sutura
  sutura completions fish > ~/.config/fish/completions/sutura.fish";

/// Writes manual pages of this command and of all its subcommands into a folder.
#[derive(Args, Debug)]
#[command(after_help = MAN)]
pub struct ManArgs {
    /// Folder for the pages, which is made if it is not there.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

const MAN: &str = "\
Examples:
  sutura man ~/.local/share/man/man1        then: man sutura-run";

/// Prints the script.
///
/// # Errors
/// If stdout cannot be written.
pub fn completions(args: &CompletionsArgs, mut command: Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "sutura", &mut script);
    match std::io::stdout().write_all(&script) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(Failure::say(
            Cause::Failed,
            format!("the script cannot be written: {error}"),
            "name a file on a disk with room for it",
        )),
        _ => Ok(()),
    }
}

/// Writes the pages, and says how many.
///
/// # Errors
/// If the folder cannot be made or written.
pub fn man(args: &ManArgs, command: Command) -> Result<(), Failure> {
    let folder = &args.folder;
    let is_page = |name: &str| name.starts_with("sutura") && name.ends_with(".1");
    crate::files::never_into(folder, is_page, &[])?;
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(command.disable_help_subcommand(true), folder))
        .and_then(|()| Ok(std::fs::read_dir(folder)?.count()));
    let files = written.map_err(|error| unwritable(folder, &error))?;
    say!("{files} pages are in {}", folder.display());
    Ok(())
}
