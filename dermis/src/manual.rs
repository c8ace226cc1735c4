//! What other programs need to know of this one: shell completions, man pages, the reference of all commands.
//!
//! All of it is made from the definition of the command line, so that it cannot differ from what `--help` prints.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Arg, Args, Command};
use clap_complete::Shell;

/// Which shell.
#[derive(Args)]
pub struct Completions {
    /// The shell that is to complete commands.
    #[arg(value_enum)]
    shell: Shell,
}

/// Where the pages go.
#[derive(Args)]
pub struct Man {
    /// Folder for the pages; made where it is missing.
    folder: PathBuf,
}

/// Prints the completion script of a shell.
pub fn completions(mut program: Command, options: &Completions) {
    let mut text = Vec::new();
    clap_complete::generate(options.shell, &mut program, "dermis", &mut text);
    print!("{}", String::from_utf8_lossy(&text));
}

/// Writes one man page for the program and one for each command.
pub fn man(program: Command, options: &Man) -> Result<()> {
    let folder = &options.folder;
    fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    clap_mangen::generate_to(program, folder)
        .with_context(|| format!("pages cannot be written to {}", folder.display()))?;
    println!("`man -l {}/dermis.1` shows the first page", folder.display());
    Ok(())
}

/// Prints every command as Markdown.
pub fn reference(program: Command) {
    print!("{}", markdown(program));
}

/// Every command as Markdown: a heading, what it does, how it is called, its arguments and options.
pub fn markdown(mut program: Command) -> String {
    program.build();
    let mut text = String::from(
        "# Every command\n\n<!-- Made by `cargo xtask docs --tables` from the program itself. Do not edit. -->\n\n\
         Every command has `--help`. Options that every command has stand under [`dermis`](#dermis) only.\n",
    );
    section(&mut text, &program, "dermis", true);
    text
}

/// Subcommands that are for people.
fn shown(command: &Command) -> impl Iterator<Item = &Command> {
    command.get_subcommands().filter(|sub| !sub.is_hide_set() && sub.get_name() != "help")
}

fn section(text: &mut String, command: &Command, name: &str, root: bool) {
    let _ = write!(text, "\n## {name}\n\n");
    if let Some(about) = command.get_long_about().or(command.get_about()) {
        let _ = write!(text, "{}\n\n", sentence(&about.to_string()));
    }
    let aliases: Vec<String> = command.get_visible_aliases().map(|alias| format!("`{alias}`")).collect();
    if !aliases.is_empty() {
        let _ = write!(text, "Also called {}.\n\n", aliases.join(", "));
    }
    let usage = command.clone().render_usage().to_string();
    let usage: Vec<&str> = usage.trim_start_matches("Usage:").lines().map(str::trim).collect();
    let _ = writeln!(text, "```text\n{}\n```", usage.join("\n"));
    let all: Vec<&Arg> = command
        .get_arguments()
        .filter(|arg| !arg.is_hide_set() && (root || !arg.is_global_set()))
        .filter(|arg| !matches!(arg.get_id().as_str(), "help" | "version"))
        .collect();
    if !all.is_empty() {
        text.push_str("\n| argument | meaning |\n|---|---|\n");
        for arg in all {
            let _ = writeln!(text, "| {} | {} |", signature(arg), meaning(arg));
        }
    }
    let subcommands: Vec<&Command> = shown(command).collect();
    if root && !subcommands.is_empty() {
        text.push_str("\n| command | what it does |\n|---|---|\n");
        for sub in &subcommands {
            let anchor = format!("dermis-{}", sub.get_name());
            let about = sub.get_about().map(|about| cell(&about.to_string())).unwrap_or_default();
            let _ = writeln!(text, "| [`{}`](#{anchor}) | {about} |", sub.get_name());
        }
    }
    for sub in subcommands {
        section(text, sub, &format!("{name} {}", sub.get_name()), false);
    }
}

/// `-o, --out OUT`, or `BAG...`.
fn signature(arg: &Arg) -> String {
    let values: Vec<String> = arg
        .get_value_names()
        .unwrap_or_default()
        .iter()
        .map(|name| if arg.is_positional() { name.to_string() } else { format!("<{name}>") })
        .collect();
    let takes = arg.get_num_args().is_some_and(|range| range.takes_values());
    let more = if arg.get_num_args().is_some_and(|range| range.max_values() > 1) { "..." } else { "" };
    let mut parts: Vec<String> = Vec::new();
    parts.extend(arg.get_short().map(|short| format!("-{short}")));
    parts.extend(arg.get_long().map(|long| format!("--{long}")));
    let mut text = parts.join(", ");
    if takes {
        if !text.is_empty() {
            text.push(' ');
        }
        text.push_str(&values.join(" "));
        text.push_str(more);
    }
    format!("`{}`", text.replace('|', "\\|"))
}

fn meaning(arg: &Arg) -> String {
    let help = arg.get_long_help().or(arg.get_help());
    let mut text = help.map(|help| cell(&help.to_string())).unwrap_or_default();
    let takes = arg.get_num_args().is_some_and(|range| range.takes_values());
    let choices: Vec<String> = arg
        .get_possible_values()
        .iter()
        .filter(|value| !value.is_hide_set())
        .map(|value| format!("`{}`", value.get_name()))
        .collect();
    if takes && !choices.is_empty() {
        let _ = write!(text, " One of {}.", choices.join(", "));
    }
    let defaults: Vec<String> =
        arg.get_default_values().iter().map(|value| format!("`{}`", value.to_string_lossy())).collect();
    if takes && !defaults.is_empty() && !arg.is_hide_default_value_set() {
        let _ = write!(text, " Default: {}.", defaults.join(", "));
    }
    if arg.is_required_set() && !arg.is_positional() {
        text.push_str(" Required.");
    }
    text.trim_start().to_owned()
}

/// A text with a full stop.
fn sentence(text: &str) -> String {
    let text = escaped(text.trim());
    if text.ends_with(['.', '?', '!', ':']) { text } else { format!("{text}.") }
}

/// A text in one cell of a table.
fn cell(text: &str) -> String {
    sentence(&dermis_io::one_line(text)).replace('|', "\\|")
}

/// Angle brackets outside of code would be HTML.
fn escaped(text: &str) -> String {
    let mut code = false;
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '`' => {
                code = !code;
                out.push(c);
            }
            '<' if !code => out.push_str("&lt;"),
            '>' if !code => out.push_str("&gt;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, ValueEnum};

    #[test]
    fn the_book_says_what_the_program_says() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/reference/commands.md");
        let written = fs::read_to_string(file).unwrap();
        assert!(
            written == markdown(crate::Cli::command()),
            "docs/reference/commands.md is stale: run `cargo xtask docs --tables`"
        );
    }

    #[test]
    fn a_command_is_described_by_its_arguments() {
        let program = Command::new("dermis").subcommand(
            Command::new("press")
                .about("Press <here> | there")
                .arg(
                    Arg::new("force")
                        .long("force")
                        .short('f')
                        .value_name("N")
                        .required(true)
                        .help("In `<N>`"),
                )
                .arg(Arg::new("at").value_name("AT").num_args(1..).default_value("top"))
                .subcommand(Command::new("secret").hide(true)),
        );
        let text = markdown(program);
        assert!(text.contains("| [`press`](#dermis-press) | Press &lt;here&gt; \\| there. |"), "{text}");
        assert!(text.contains("| `-f, --force <N>` | In `<N>`. Required. |"), "{text}");
        assert!(text.contains("| `AT...` | Default: `top`. |"), "{text}");
        assert!(!text.contains("secret"), "{text}");
    }

    #[test]
    fn every_command_has_a_page_and_every_shell_a_script() {
        let dir = tempfile::tempdir().unwrap();
        let options = Man { folder: dir.path().join("man") };
        man(crate::Cli::command(), &options).unwrap();
        for page in ["dermis.1", "dermis-demo.1", "dermis-bag-slice.1"] {
            let text = fs::read_to_string(options.folder.join(page)).unwrap();
            assert!(text.contains(".SH NAME") && text.contains(".SH SYNOPSIS"), "{page}: {text}");
        }
        assert!(!options.folder.join("dermis-launch-guard.1").exists());
        for shell in Shell::value_variants() {
            let mut text = Vec::new();
            clap_complete::generate(*shell, &mut crate::Cli::command(), "dermis", &mut text);
            assert!(String::from_utf8_lossy(&text).contains("barodome"), "{shell}");
        }
    }

    /// Lines of shell code that start this program.
    fn commands(text: &str) -> Vec<String> {
        let (mut shell, mut found, mut open) = (false, Vec::new(), String::new());
        for line in text.lines() {
            if line.trim_start().starts_with("```") {
                shell = line.trim() == "```sh" && !shell;
                continue;
            }
            if !shell {
                continue;
            }
            open.push_str(line.trim_end().trim_end_matches('\\'));
            if !line.trim_end().ends_with('\\') {
                found.push(std::mem::take(&mut open));
            }
        }
        let starts = ["dermis ", "target/release/dermis ", "cargo run --release -- "];
        let ours = found.into_iter().filter_map(|line| {
            let arguments = starts.iter().find_map(|start| line.trim_start().strip_prefix(start))?;
            let ends = [" #", " | ", " > ", " &"];
            let end = ends.iter().filter_map(|end| arguments.find(end)).min().unwrap_or(arguments.len());
            Some(format!("dermis {}", &arguments[..end]))
        });
        ours.filter(|line| !line.contains('…')).collect()
    }

    fn pages(folder: &std::path::Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                pages(&path, found);
            } else if path.extension().is_some_and(|e| e == "md") {
                found.push(path);
            }
        }
    }

    #[test]
    fn every_command_that_is_shown_can_be_given() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let mut files: Vec<PathBuf> =
            ["README.md", "launch/README.md", "models/README.md"].map(|f| root.join(f)).into();
        pages(&root.join("docs"), &mut files);
        pages(&root.join("examples"), &mut files);
        let (mut count, mut wrong) = (0, String::new());
        for file in files {
            for command in commands(&fs::read_to_string(&file).unwrap()) {
                count += 1;
                let words = command.split_whitespace().map(|word| word.trim_matches(['\'', '"']));
                let Err(error) = crate::Cli::command().try_get_matches_from(words) else { continue };
                if error.kind() != clap::error::ErrorKind::DisplayHelp {
                    let _ = writeln!(wrong, "{}: `{command}`: {error}", file.display());
                }
            }
        }
        assert!(wrong.is_empty(), "{wrong}");
        assert!(count > 60, "{count} commands were found");
    }
}
