//! Links of Markdown files: where they lead, and whether that is there. No network is needed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

use anyhow::Result;

/// A link as a file writes it.
pub struct Link {
    pub line: usize,
    pub target: String,
}

/// The files whose links are checked.
fn files(root: &Path) -> Result<Vec<PathBuf>> {
    let mut found: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"]
        .map(|name| root.join(name))
        .into_iter()
        .filter(|path| path.exists())
        .collect();
    for folder in ["docs", "examples"] {
        super::markdown(&root.join(folder), &mut found)?;
    }
    for file in ["launch/README.md", "models/README.md", "crates/transport/WIRE.md"] {
        found.push(root.join(file));
    }
    Ok(found)
}

/// Links that lead nowhere, one sentence each.
pub fn broken(root: &Path) -> Result<Vec<String>> {
    let mut anchors: BTreeMap<PathBuf, Vec<String>> = BTreeMap::new();
    let mut broken = Vec::new();
    for path in files(root)? {
        let text = fs::read_to_string(&path)?;
        for link in of(&text) {
            let (file, anchor) = match link.target.split_once('#') {
                Some((file, anchor)) => (file, Some(anchor)),
                None => (link.target.as_str(), None),
            };
            let at = format!("{}:{}", path.strip_prefix(root).unwrap_or(&path).display(), link.line);
            let aim = match file {
                "" => Some(path.strip_prefix(root).unwrap_or(&path).to_owned()),
                file => resolve(root, &path, file),
            };
            let Some(aim) = aim else {
                if !outside(file) {
                    broken.push(format!("{at}: {} leaves the repository", link.target));
                }
                continue;
            };
            let aim = root.join(aim);
            if !aim.exists() {
                broken.push(format!("{at}: {} is not there", link.target));
                continue;
            }
            if let Some(anchor) = anchor
                && aim.extension().is_some_and(|e| e == "md")
            {
                if !anchors.contains_key(&aim) {
                    anchors.insert(aim.clone(), headings(&fs::read_to_string(&aim)?));
                }
                if !anchors[&aim].iter().any(|known| known == anchor) {
                    broken.push(format!("{at}: {} has no heading `{anchor}`", aim.display()));
                }
            }
        }
    }
    Ok(broken)
}

/// Whether a link leads to the network, which is not inspected.
fn outside(target: &str) -> bool {
    ["http://", "https://", "mailto:"].iter().any(|scheme| target.starts_with(scheme))
}

/// The file that a relative link of a page means, relative to the repository; `None` where it lies elsewhere.
pub fn resolve(root: &Path, page: &Path, target: &str) -> Option<PathBuf> {
    if target.is_empty() || outside(target) {
        return None;
    }
    let mut aim = page.parent()?.strip_prefix(root).ok()?.to_owned();
    for part in Path::new(target).components() {
        match part {
            Component::ParentDir => {
                if !aim.pop() {
                    return None;
                }
            }
            Component::Normal(name) => aim.push(name),
            Component::CurDir => {}
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(aim)
}

/// Links and pictures of a text, those in code left out.
pub fn of(text: &str) -> Vec<Link> {
    let mut found = Vec::new();
    walk(text, |line, target| {
        found.push(Link { line, target: target.to_owned() });
        None
    });
    found
}

/// A text with other targets where `change` names one.
pub fn rewrite(text: &str, mut change: impl FnMut(&str) -> Option<String>) -> String {
    walk(text, |_, target| change(target))
}

/// Goes through `](target)` outside of code and comments; answers the text with what `change` put in place of targets.
fn walk(text: &str, mut change: impl FnMut(usize, &str) -> Option<String>) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut fence, mut comment) = (None::<&str>, false);
    for (i, line) in text.split_inclusive('\n').enumerate() {
        let start = line.trim_start();
        if let Some(mark) = fence {
            if start.starts_with(mark) {
                fence = None;
            }
            out.push_str(line);
            continue;
        }
        if let Some(mark) = ["```", "~~~"].into_iter().find(|mark| start.starts_with(mark)) {
            fence = Some(mark);
            out.push_str(line);
            continue;
        }
        comment |= start.starts_with("<!--");
        if comment {
            comment = !line.contains("-->");
            out.push_str(line);
            continue;
        }
        let mut rest = line;
        let mut code = false;
        while let Some(at) = rest.find(['`', ']']) {
            let (before, after) = rest.split_at(at);
            out.push_str(before);
            if let Some(end) = after.strip_prefix('`') {
                code = !code;
                out.push('`');
                rest = end;
            } else if let (false, Some((target, end))) =
                (code, after.strip_prefix("](").and_then(|a| a.split_once(')')))
            {
                out.push_str("](");
                out.push_str(&change(i + 1, target).unwrap_or_else(|| target.to_owned()));
                out.push(')');
                rest = end;
            } else {
                out.push(']');
                rest = after.strip_prefix(']').unwrap_or_default();
            }
        }
        out.push_str(rest);
    }
    out
}

/// Anchors of a text's headings, as GitHub and mdBook make them.
fn headings(text: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut fence = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fence = !fence;
        }
        let title = line.trim_start_matches('#');
        if fence || title.len() == line.len() || !title.starts_with(' ') {
            continue;
        }
        let name: String = title
            .trim()
            .to_lowercase()
            .chars()
            .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
            .map(|c| if c == ' ' { '-' } else { c })
            .collect();
        let count = seen.entry(name.clone()).or_default();
        found.push(if *count == 0 { name } else { format!("{name}-{count}") });
        *count += 1;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_in_code_and_comments_are_none() {
        let text = "[a](b.md) `[c](d)` ![p](q.svg)\n```\n[e](f)\n```\n<!--\n[g](h)\n-->\n[[1]](i#j)\n";
        let found: Vec<(usize, String)> = of(text).into_iter().map(|l| (l.line, l.target)).collect();
        assert_eq!(found, [(1, "b.md".to_owned()), (1, "q.svg".to_owned()), (8, "i#j".to_owned())]);
    }

    #[test]
    fn headings_become_anchors() {
        let text = "# One `two` (3)\n## Same\n## Same\n```\n# no\n```\n#no\n## frame_id and TF\n";
        assert_eq!(headings(text), ["one-two-3", "same", "same-1", "frame_id-and-tf"]);
    }

    #[test]
    fn a_broken_link_is_named_with_file_and_line() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        for folder in ["docs", "examples", "launch", "models", "crates/transport"] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        for file in ["launch/README.md", "models/README.md", "crates/transport/WIRE.md"] {
            fs::write(root.join(file), "# Title\n").unwrap();
        }
        let text = "[ok](../launch/README.md#title)\n[no](../launch/README.md#titel)\n[gone](x.md)\n\
                    [web](https://example.org/)\n[up](../../x)\n[here](#there)\n";
        fs::write(root.join("docs/a.md"), text).unwrap();
        let found = broken(root).unwrap();
        assert_eq!(found.len(), 4, "{found:?}");
        for (sentence, start) in
            found.iter().zip(["docs/a.md:2", "docs/a.md:3", "docs/a.md:5", "docs/a.md:6"])
        {
            assert!(sentence.starts_with(start), "{sentence}");
        }
    }

    #[test]
    fn a_rewritten_text_is_the_same_elsewhere() {
        let text = "a [b](c) `x](y)` d\n";
        assert_eq!(rewrite(text, |_| None), text);
        assert_eq!(rewrite(text, |t| Some(t.to_uppercase())), "a [b](C) `x](y)` d\n");
    }
}
