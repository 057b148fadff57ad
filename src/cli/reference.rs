//! Writes the page of the docs that lists every command and option, from the parser's own declarations.

use clap::{Arg, ArgAction, Command, CommandFactory};

use super::Cli;

/// Text of a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

/// The option as it is written on a command line.
fn usage(arg: &Arg) -> String {
    let names = arg.get_value_names().unwrap_or_default();
    let values: Vec<String> = names.iter().map(|name| format!("<{name}>")).collect();
    let takes_value = !matches!(arg.get_action(), ArgAction::SetTrue | ArgAction::Count);
    let value = if takes_value { values.join(" ") } else { String::new() };
    // A flag that takes a value only with `=`.
    if takes_value && arg.is_require_equals_set() {
        return format!("--{}[=true|false]", arg.get_long().unwrap_or_default());
    }
    let short = arg.get_short().map(|short| format!("-{short}"));
    let long = arg.get_long().map(|long| format!("--{long}"));
    let names: Vec<String> = short.into_iter().chain(long).collect();
    format!("{} {value}", names.join(", ")).trim().to_owned()
}

/// Help, values and default of an option.
fn meaning(arg: &Arg) -> String {
    let help = arg.get_long_help().or(arg.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut text = cell(&help);
    let values: Vec<String> = arg
        .get_possible_values()
        .iter()
        .filter(|value| !value.is_hide_set())
        .map(|value| format!("`{}`", value.get_name()))
        .collect();
    let is_flag = values == ["`true`", "`false`"];
    if !values.is_empty() && !is_flag && arg.get_action().takes_values() {
        let stop = if text.ends_with(['.', ':']) { "" } else { "." };
        text += &format!("{stop} Values: {}.", values.join(", "));
    }
    let defaults: Vec<String> =
        arg.get_default_values().iter().map(|value| format!("`{}`", value.display())).collect();
    if !defaults.is_empty() && arg.get_action().takes_values() {
        text += &format!(" [default: {}]", defaults.join(", "));
    }
    if let Some(variable) = arg.get_env() {
        text += &format!(" [env: `{}`]", variable.display());
    }
    text
}

fn section(command: &Command) -> String {
    let mut text = format!("\n## pointillist {}\n\n", command.get_name());
    if let Some(about) = command.get_about() {
        text += &format!("{about}.\n\n");
    }
    text += "| option | meaning |\n|---|---|\n";
    let shown =
        |arg: &&Arg| !arg.is_hide_set() && !["help", "version"].contains(&arg.get_id().as_str());
    for arg in command.get_arguments().filter(shown) {
        text += &format!("| `{}` | {} |\n", usage(arg), meaning(arg));
    }
    text
}

fn page() -> String {
    let mut root = Cli::command();
    root.build();
    let mut text = String::from(
        "# Commands and options\n\nWhat `pointillist COMMAND --help` prints, on one page. See also [Use the command line](commands.md).\n",
    );
    let commands = root.get_subcommands().filter(|command| !command.is_hide_set());
    for command in commands.filter(|command| command.get_name() != "help") {
        text += &section(command);
    }
    text
}

/// `UPDATE=1` writes the page anew.
#[test]
fn the_docs_list_every_option() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/cli.md");
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&file, page()).unwrap();
    }
    assert_eq!(std::fs::read_to_string(file).unwrap(), page(), "UPDATE=1 writes it anew");
}
