//! The command line against its own promises.

use super::*;
use clap::Command;
use std::collections::BTreeMap;

fn overlaid(file: &str, arguments: &[&str]) -> Config {
    let file: Config = toml::from_str(file).expect("valid file");
    let matches = Cli::command()
        .try_get_matches_from(arguments)
        .expect("valid flags");
    let cli = Cli::from_arg_matches(&matches).expect("parses");
    let (verb, verb_matches) = matches.subcommand().expect("verb");
    file.overlaid(&cli.flags(), config::tables_of(verb), verb_matches)
        .expect("merges")
}

#[test]
fn clap_accepts_the_definition() {
    Cli::command().debug_assert();
}

#[test]
fn every_option_has_a_help_sentence_of_its_own() {
    fn walk(command: &Command, path: &str) {
        let mut seen: BTreeMap<String, String> = BTreeMap::new();
        for arg in command.get_arguments() {
            let id = arg.get_id().to_string();
            let help = arg
                .get_help()
                .unwrap_or_else(|| panic!("{path} {id} has no help"))
                .to_string();
            assert!(help.len() > 10, "{path} {id}: {help}");
            if let Some(other) = seen.insert(help.clone(), id.clone()) {
                panic!("{path}: {id} and {other} share the sentence {help:?}");
            }
        }
        assert!(
            command.get_about().is_some() || path == "unbake help",
            "{path} has no description"
        );
        for sub in command.get_subcommands().filter(|s| s.get_name() != "help") {
            walk(sub, &format!("{path} {}", sub.get_name()));
        }
    }
    walk(&Cli::command(), "unbake");
}

/// Where the help names a number as an option's default, it is the preset's.
#[test]
fn defaults_in_the_help_are_those_of_the_default_preset() {
    let preset = serde_json::to_value(crate::pipeline::SolveOptions::default()).expect("options");
    let command = Cli::command();
    let solve = command.find_subcommand("solve").expect("a verb");
    let mut compared = 0;
    for arg in solve.get_arguments() {
        let (Some(help), Some(key)) = (arg.get_help().map(ToString::to_string), arg.get_long())
        else {
            continue;
        };
        let stated = help
            .split_once("[default: ")
            .and_then(|(_, rest)| rest.split([']', ' ']).next()?.parse::<f64>().ok());
        if let (Some(stated), Some(actual)) =
            (stated, preset.get(key).and_then(serde_json::Value::as_f64))
        {
            assert!(
                (stated - actual).abs() < 1e-6,
                "--{key}: the help says {stated}, the preset {actual}"
            );
            compared += 1;
        }
    }
    assert!(compared >= 8, "{compared}");
}

/// Arguments that say what to work on or how to run rather than how to compute: the only ones
/// without a key.
const WITHOUT_KEY: [&str; 14] = [
    "complete",
    "config",
    "print_config",
    "version",
    "out",
    "scene",
    "help",
    "folder",
    "to",
    "cameras",
    "lights",
    "list_lamps",
    "edits",
    "clear",
];

#[test]
fn every_flag_is_a_key_and_every_key_is_a_flag() {
    fn leaves(table: &toml::Table, into: &mut Vec<String>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(inner) => leaves(inner, into),
                _ => into.push(key.clone()),
            }
        }
    }
    let config = toml::Table::try_from(Config::default()).expect("serialises");
    for verb in Cli::command().get_subcommands() {
        let mut keys = Vec::new();
        for table in config::tables_of(verb.get_name()) {
            match config.get(*table) {
                Some(toml::Value::Table(table)) => leaves(table, &mut keys),
                _ => panic!(
                    "{} reads a table [{table}] that does not exist",
                    verb.get_name()
                ),
            }
        }
        for key in &keys {
            let known = verb
                .get_arguments()
                .any(|a| a.get_id().as_str().replace('_', "-") == *key);
            assert!(known, "{key} has no flag in {}", verb.get_name());
        }
        for arg in verb
            .get_arguments()
            .filter(|a| !a.is_positional() && !a.is_global_set())
        {
            let id = arg.get_id().as_str();
            // an option without a default is absent from the default configuration
            let optional = arg.get_default_values().is_empty()
                && !matches!(arg.get_action(), clap::ArgAction::SetTrue);
            let known =
                keys.contains(&id.replace('_', "-")) || WITHOUT_KEY.contains(&id) || optional;
            assert!(known, "--{id} of {} has no key", verb.get_name());
        }
    }
}

#[test]
fn typed_flags_override_the_file_and_defaults_do_not() {
    let file = "threads = 3\nseed = 5\n[eval]\nexposure = 2.5\nquantise = true\n";
    let arguments = [
        "unbake",
        "--seed",
        "9",
        "eval",
        "OUT",
        "--scene",
        "S",
        "--train",
        "--threads",
        "2",
    ];
    let config = overlaid(file, &arguments);
    assert_eq!((config.threads, config.seed), (Some(2), Some(9)));
    assert!(
        (config.eval.exposure - 2.5).abs() < 1e-9,
        "a default must not override the file"
    );
    assert!(config.eval.quantise && config.eval.train);
    assert!(
        overlaid(
            "",
            &["unbake", "eval", "OUT", "--scene", "S", "--clamp-nan"]
        )
        .scene
        .clamp_nan,
        "shared tables as well"
    );
    let typed = overlaid(
        file,
        &["unbake", "eval", "OUT", "--scene", "S", "--exposure", "-1"],
    );
    assert!((typed.eval.exposure + 1.0).abs() < 1e-9);
}

#[test]
fn the_printed_configuration_reads_back_as_itself() {
    let config = Config {
        threads: Some(4),
        seed: Some(11),
        ..Config::default()
    };
    let text = config.documented(&Cli::command(), None).expect("prints");
    assert_eq!(toml::from_str::<Config>(&text).expect("parses"), config);
    assert!(
        text.contains("# Key of every random number"),
        "keys carry their help:\n{text}"
    );
    let only = config
        .documented(&Cli::command(), Some("eval"))
        .expect("prints");
    assert!(
        only.contains("[eval]") && only.contains("[scene]") && !only.contains("[solve]"),
        "{only}"
    );
}

#[test]
fn a_misspelt_key_is_named_with_its_line() {
    let folder = tempfile::tempdir().expect("temp");
    let path = folder.path().join("c.toml");
    std::fs::write(&path, "seed = 1\n[eval]\nexposre = 1.0\n").expect("writes");
    let e = Config::read(&path).expect_err("misspelt");
    assert_eq!(e.exit_code(), 2);
    assert!(
        e.to_string().contains("exposre") && e.to_string().contains("line 3"),
        "{e}"
    );
}
