//! Which commands a node obeys.
//!
//! A command changes what a node does: whoever reaches its services can give one. A node that is finished may be configured to obey only
//! some groups of commands, or none. Services of the others stay, and answer with a sentence: a ROS client waits without end for a
//! service that is not there. What only reads (the state, parameters and their descriptions) is answered always.

use std::fmt;
use std::str::FromStr;

use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A group of commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Command {
    /// `~/tare`.
    Tare,
    /// `~/set_enabled`.
    Enable,
    /// `~/load_model`.
    Load,
    /// `~/change_state`: configure, activate, deactivate, shut down.
    Lifecycle,
    /// `~/set_parameters` and `~/set_parameters_atomically`.
    Parameters,
}

impl Command {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Tare, Self::Enable, Self::Load, Self::Lifecycle, Self::Parameters];

    /// As configurations name it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tare => "tare",
            Self::Enable => "enable",
            Self::Load => "load",
            Self::Lifecycle => "lifecycle",
            Self::Parameters => "parameters",
        }
    }
}

/// The commands that a node obeys: `"all"`, `"none"`, or a list of groups.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Commands(Vec<Command>);

impl Default for Commands {
    /// All of them.
    fn default() -> Self {
        Self(Command::ALL.to_vec())
    }
}

impl Commands {
    /// None of them.
    #[must_use]
    pub fn none() -> Self {
        Self(Vec::new())
    }

    /// Whether a group is obeyed.
    #[must_use]
    pub fn obeys(&self, command: Command) -> bool {
        self.0.contains(&command)
    }

    /// Why a command is refused; `None` where it is obeyed.
    #[must_use]
    pub fn refusal(&self, command: Command) -> Option<String> {
        (!self.obeys(command)).then(|| {
            format!(
                "this node does not obey commands of the group `{}`: its configuration says `commands = {self}`",
                command.name()
            )
        })
    }

    fn of<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<Self, UnknownCommand> {
        let mut found = Vec::new();
        for name in names {
            let command = Command::ALL
                .into_iter()
                .find(|c| c.name() == name)
                .ok_or_else(|| UnknownCommand(name.to_owned()))?;
            found.push(command);
        }
        found.sort();
        found.dedup();
        Ok(Self(found))
    }
}

/// A group of commands that there is not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no group of commands `{0}`; give `all`, `none`, or some of tare, enable, load, lifecycle, parameters"
)]
pub struct UnknownCommand(String);

impl FromStr for Commands {
    type Err = UnknownCommand;

    /// `all`, `none`, or groups with commas between them.
    fn from_str(text: &str) -> Result<Self, UnknownCommand> {
        match text.trim() {
            "all" => Ok(Self::default()),
            "none" => Ok(Self::none()),
            list => Self::of(list.split(',').map(str::trim)),
        }
    }
}

impl fmt::Display for Commands {
    /// As a configuration file says it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.as_slice() {
            [] => f.write_str("\"none\""),
            all if all.len() == Command::ALL.len() => f.write_str("\"all\""),
            some => f.debug_list().entries(some.iter().map(|c| c.name())).finish(),
        }
    }
}

impl Serialize for Commands {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.as_slice() {
            [] => serializer.serialize_str("none"),
            all if all.len() == Command::ALL.len() => serializer.serialize_str("all"),
            some => serializer.collect_seq(some.iter().map(|c| c.name())),
        }
    }
}

impl<'de> Deserialize<'de> for Commands {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Given;

        impl<'de> Visitor<'de> for Given {
            type Value = Commands;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(
                    "\"all\", \"none\", or a list of \"tare\", \"enable\", \"load\", \"lifecycle\", \"parameters\"",
                )
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Commands, E> {
                text.parse().map_err(E::custom)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Commands, A::Error> {
                let mut names = Vec::<String>::new();
                while let Some(name) = list.next_element()? {
                    names.push(name);
                }
                Commands::of(names.iter().map(String::as_str)).map_err(de::Error::custom)
            }
        }

        deserializer.deserialize_any(Given)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_and_a_command_line_say_the_same() {
        let json = |text: &str| serde_json::from_str::<Commands>(text).map_err(|e| e.to_string());
        let cli = |text: &str| text.parse::<Commands>().map_err(|e| e.to_string());
        assert_eq!((json("\"all\""), cli("all")), (Ok(Commands::default()), Ok(Commands::default())));
        assert_eq!((json("\"none\""), json("[]"), cli("none")), {
            let none = Commands::none;
            (Ok(none()), Ok(none()), Ok(none()))
        });
        let some = cli("enable, tare").unwrap();
        assert_eq!(json("[\"tare\", \"enable\"]").unwrap(), some);
        assert!(some.obeys(Command::Tare) && !some.obeys(Command::Load));
        for commands in [some, Commands::none(), Commands::default()] {
            let text = serde_json::to_string(&commands).unwrap();
            assert_eq!(json(&text).unwrap(), commands, "{text}");
        }
        insta::assert_snapshot!(cli("tare,lode").unwrap_err(), @"there is no group of commands `lode`; give `all`, `none`, or some of tare, enable, load, lifecycle, parameters");
        insta::assert_snapshot!(json("7").unwrap_err(), @r#"invalid type: integer `7`, expected "all", "none", or a list of "tare", "enable", "load", "lifecycle", "parameters" at line 1 column 1"#);
        insta::assert_snapshot!(cli("tare").unwrap().refusal(Command::Load).unwrap(), @r#"this node does not obey commands of the group `load`: its configuration says `commands = ["tare"]`"#);
    }
}
