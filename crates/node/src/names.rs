//! ROS names: validation, expansion, remapping.

use crate::error::NodeError;

/// What a name is for, in error messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NameKind {
    Topic,
    Service,
    Node,
    Namespace,
}

impl NameKind {
    const fn word(self) -> &'static str {
        match self {
            Self::Topic => "topic",
            Self::Service => "service",
            Self::Node => "node",
            Self::Namespace => "namespace",
        }
    }
}

/// Joins an absolute namespace and a relative name.
pub(crate) fn join(namespace: &str, name: &str) -> String {
    let namespace = namespace.trim_end_matches('/');
    format!("{namespace}/{name}")
}

/// The names of one node.
#[derive(Debug, Clone)]
pub(crate) struct Names {
    /// Node name without namespace.
    pub name: String,
    /// Absolute namespace.
    pub namespace: String,
    /// Remappings of topics and services, fully qualified on both sides.
    rules: Vec<(String, String)>,
}

impl Names {
    /// Checks node name and namespace and applies the rules `__node`, `__name` and `__ns`.
    pub(crate) fn new(
        name: &str,
        namespace: &str,
        remappings: &[(String, String)],
    ) -> Result<Self, NodeError> {
        let mut name = name.to_owned();
        let mut namespace = namespace.to_owned();
        for (from, to) in remappings {
            match from.as_str() {
                "__node" | "__name" => name.clone_from(to),
                "__ns" => namespace.clone_from(to),
                _ => {}
            }
        }
        check_token(&name, &name, NameKind::Node)?;
        let namespace = check_namespace(&namespace)?;
        let mut names = Self { name, namespace, rules: Vec::new() };
        for (from, to) in remappings {
            if from.starts_with("__") {
                continue;
            }
            let rule = (names.expand(from, NameKind::Topic)?, names.expand(to, NameKind::Topic)?);
            names.rules.push(rule);
        }
        Ok(names)
    }

    /// `/ns/name`.
    pub(crate) fn full_name(&self) -> String {
        join(&self.namespace, &self.name)
    }

    /// Fully qualifies a relative (`contacts`), private (`~/tare`) or absolute (`/clock`) name, then
    /// applies the first remapping that fits.
    pub(crate) fn resolve(&self, name: &str, kind: NameKind) -> Result<String, NodeError> {
        let full = self.expand(name, kind)?;
        Ok(self.rules.iter().find(|(from, _)| *from == full).map_or(full, |(_, to)| to.clone()))
    }

    fn expand(&self, name: &str, kind: NameKind) -> Result<String, NodeError> {
        let invalid = |reason: String| NodeError::Name { kind: kind.word(), name: name.to_owned(), reason };
        if name.is_empty() {
            return Err(invalid("it is empty".to_owned()));
        }
        let replaced = name
            .replace("{node}", &self.name)
            .replace("{ns}", self.namespace.trim_start_matches('/'))
            .replace("{namespace}", self.namespace.trim_start_matches('/'));
        let full = if replaced == "~" {
            self.full_name()
        } else if let Some(rest) = replaced.strip_prefix("~/") {
            join(&self.full_name(), rest)
        } else if replaced.starts_with('~') {
            return Err(invalid("`~` must be followed by `/`".to_owned()));
        } else if replaced.starts_with('/') {
            replaced
        } else {
            join(&self.namespace, &replaced)
        };
        for token in full[1..].split('/') {
            check_token(token, name, kind)?;
        }
        Ok(full)
    }
}

fn check_namespace(namespace: &str) -> Result<String, NodeError> {
    if namespace.is_empty() || namespace == "/" {
        return Ok("/".to_owned());
    }
    let absolute = if namespace.starts_with('/') { namespace.to_owned() } else { format!("/{namespace}") };
    for token in absolute[1..].split('/') {
        check_token(token, namespace, NameKind::Namespace)?;
    }
    Ok(absolute)
}

fn check_token(token: &str, whole: &str, kind: NameKind) -> Result<(), NodeError> {
    let invalid = |reason: String| Err(NodeError::Name { kind: kind.word(), name: whole.to_owned(), reason });
    let Some(first) = token.chars().next() else {
        return invalid(if whole.is_empty() {
            "it is empty".to_owned()
        } else {
            "it has an empty part: remove the doubled or trailing `/`".to_owned()
        });
    };
    if first.is_ascii_digit() {
        return invalid(format!("its part `{token}` starts with a digit"));
    }
    if let Some(bad) = token.chars().find(|c| !c.is_ascii_alphanumeric() && *c != '_') {
        return invalid(format!("`{bad}` is not allowed: use letters, digits and `_`"));
    }
    if kind != NameKind::Node && token.contains("__") {
        return invalid(format!("its part `{token}` has two underscores in a row"));
    }
    Ok(())
}

/// Reads a remapping rule `from:=to`.
///
/// # Errors
///
/// When the text has no `:=` or an empty side.
pub fn parse_remapping(rule: &str) -> Result<(String, String), NodeError> {
    match rule.split_once(":=") {
        Some((from, to)) if !from.is_empty() && !to.is_empty() => Ok((from.to_owned(), to.to_owned())),
        _ => Err(NodeError::Remapping { rule: rule.to_owned() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Names {
        let rules =
            [("contacts".to_owned(), "/body/contacts".to_owned()), ("~/tare".to_owned(), "zero".to_owned())];
        Names::new("palm", "left/hand", &rules).unwrap()
    }

    #[test]
    fn names_are_expanded() {
        let names = names();
        assert_eq!(names.full_name(), "/left/hand/palm");
        for (name, full) in [
            ("force_map", "/left/hand/force_map"),
            ("~/state", "/left/hand/palm/state"),
            ("/clock", "/clock"),
            ("~", "/left/hand/palm"),
            ("{node}/x", "/left/hand/palm/x"),
        ] {
            assert_eq!(names.resolve(name, NameKind::Topic).unwrap(), full);
        }
    }

    #[test]
    fn names_are_remapped() {
        let names = names();
        assert_eq!(names.resolve("contacts", NameKind::Topic).unwrap(), "/body/contacts");
        assert_eq!(names.resolve("/left/hand/contacts", NameKind::Topic).unwrap(), "/body/contacts");
        assert_eq!(names.resolve("~/tare", NameKind::Service).unwrap(), "/left/hand/zero");
        let renamed = [("__node".to_owned(), "back".to_owned()), ("__ns".to_owned(), "/right".to_owned())];
        assert_eq!(Names::new("palm", "/", &renamed).unwrap().full_name(), "/right/back");
    }

    #[test]
    fn bad_names_are_refused_with_a_reason() {
        let names = names();
        let message = |name: &str| names.resolve(name, NameKind::Topic).unwrap_err().to_string();
        insta::assert_snapshot!(message(""), @"topic name `` is not valid: it is empty");
        insta::assert_snapshot!(message("a//b"), @"topic name `a//b` is not valid: it has an empty part: remove the doubled or trailing `/`");
        insta::assert_snapshot!(message("a b"), @"topic name `a b` is not valid: ` ` is not allowed: use letters, digits and `_`");
        insta::assert_snapshot!(message("3d"), @"topic name `3d` is not valid: its part `3d` starts with a digit");
        insta::assert_snapshot!(message("~x"), @"topic name `~x` is not valid: `~` must be followed by `/`");
        insta::assert_snapshot!(message("a__b"), @"topic name `a__b` is not valid: its part `a__b` has two underscores in a row");
        insta::assert_snapshot!(Names::new("", "/", &[]).unwrap_err(), @"node name `` is not valid: it is empty");
        insta::assert_snapshot!(parse_remapping("a=b").unwrap_err(), @"remapping `a=b` is not of the form `from:=to`");
    }

    proptest::proptest! {
        #[test]
        fn no_name_panics(name in ".{0,20}", namespace in ".{0,10}") {
            let full = Names::new("n", &namespace, &[])
                .and_then(|names| names.resolve(&name, NameKind::Topic));
            if let Ok(full) = full {
                proptest::prop_assert!(full.starts_with('/'));
                proptest::prop_assert!(!full.contains("//"));
            }
        }
    }
}
