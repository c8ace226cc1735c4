//! Pages and figures in a real browser: nothing is cut off, no label is covered or runs into another, nothing runs out of its
//! page. Screenshots stay in the folder of the tests' own files, for people.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use dermis_integration_tests::{finish, program, root};

/// What a browser says of a page, as JSON: faults that a reader would see.
const LOOK: &str = r#"
<pre id="found">[]</pre>
<script>
addEventListener("load", () => {
  const faults = [];
  const box = e => e.getBoundingClientRect();
  const page = document.documentElement;
  if (page.scrollWidth > page.clientWidth + 1) faults.push("the page is wider than its window");
  const outermost = e => { while (e.ownerSVGElement) e = e.ownerSVGElement; return e; };
  const texts = [...document.querySelectorAll("svg text")].filter(t => t.textContent.trim() && box(t).width > 0);
  const told = t => JSON.stringify(t.textContent.trim());
  for (const text of texts) {
    const own = box(text), frame = box(outermost(text));
    if (own.left < frame.left - 1 || own.right > frame.right + 1 || own.top < frame.top - 1 || own.bottom > frame.bottom + 1)
      faults.push(told(text) + " is cut off");
    const top = document.elementFromPoint((own.left + own.right) / 2, (own.top + own.bottom) / 2);
    const area = top && top.tagName.toLowerCase() !== "text" && ["rect", "image", "path", "polygon"].includes(top.tagName.toLowerCase());
    if (area && (top.compareDocumentPosition(text) & Node.DOCUMENT_POSITION_PRECEDING))
      faults.push(told(text) + " is covered by a " + top.tagName);
  }
  // Corners of a text as it stands, turned or not, a tenth smaller than its box: lines may stand close.
  const corners = t => {
    const b = t.getBBox(), m = t.getScreenCTM(), at = [[0.05, 0.1], [0.95, 0.1], [0.95, 0.9], [0.05, 0.9]];
    return at.map(([u, v]) => new DOMPoint(b.x + u * b.width, b.y + v * b.height).matrixTransform(m));
  };
  // Two convex shapes are apart where a side of one has the other wholly beyond it.
  const beyond = (a, b) => a.some((p, i) => {
    const q = a[(i + 1) % a.length], side = r => (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
    const inner = side(a[(i + 2) % a.length]);
    return b.every(r => side(r) * inner <= 0);
  });
  const shapes = texts.map(corners);
  for (let i = 0; i < texts.length; i++) for (let j = 0; j < i; j++)
    if (outermost(texts[i]) === outermost(texts[j]) && !beyond(shapes[i], shapes[j]) && !beyond(shapes[j], shapes[i]))
      faults.push(told(texts[i]) + " runs into " + told(texts[j]));
  document.getElementById("found").textContent = JSON.stringify(faults);
});
</script>
"#;

/// Width and height of the window, in which a whole page is seen.
const WINDOW: &str = "--window-size=1400,12000";

fn browser() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found = std::env::split_paths(&path)
        .flat_map(|folder| names.map(|name| folder.join(name)))
        .find(|p| p.is_file());
    if found.is_none() {
        eprintln!("skipped: there is no Chromium; `cargo xtask test` installs one where it may");
    }
    found
}

fn open(browser: &Path, page: &Path, arguments: &[String]) -> String {
    let profile = tempfile::tempdir().unwrap();
    let mut command = Command::new(browser);
    command
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            WINDOW,
        ])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args(arguments)
        .arg(format!("file://{}", page.display()))
        .stderr(Stdio::null());
    finish(&mut command)
}

/// What is wrong with how a page or an SVG looks; `None` where there is no browser.
fn faults(file: &Path) -> Option<Vec<String>> {
    let browser = browser()?;
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(file).unwrap();
    // A figure by itself stands in a page of its own; a page gets the script at its end.
    let seen = folder.path().join("page.html");
    let (head, tail) = text.rsplit_once("</body>").unwrap_or((&text, ""));
    std::fs::write(&seen, format!("<!doctype html>\n{head}{LOOK}{tail}")).unwrap();
    let shots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("screenshots");
    std::fs::create_dir_all(&shots).unwrap();
    let name = file.file_stem().unwrap().to_string_lossy().into_owned();
    let shot = shots.join(format!("{name}-{}.png", std::process::id()));
    open(&browser, file, &[format!("--screenshot={}", shot.display())]);
    assert!(std::fs::metadata(&shot).unwrap().len() > 1000, "{} is empty", shot.display());
    std::fs::rename(&shot, shots.join(format!("{name}.png"))).unwrap();
    let dom = open(&browser, &seen, &["--dump-dom".to_owned()]);
    let found = dom.rsplit_once("<pre id=\"found\">").and_then(|(_, rest)| rest.split_once("</pre>"));
    let (found, _) = found.unwrap_or_else(|| panic!("the browser did not show {}", file.display()));
    let found = found.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    Some(serde_json::from_str(&found).unwrap())
}

/// Says what is wrong with how a page or an SVG looks.
///
/// # Panics
///
/// Where something is.
pub fn looks_right(file: &Path) {
    if let Some(faults) = faults(file) {
        assert!(faults.is_empty(), "{}:\n{}", file.display(), faults.join("\n"));
    }
}

#[test]
fn a_bad_figure_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("bad.svg");
    let text = r##"<svg xmlns="http://www.w3.org/2000/svg" width="200" height="100">
        <text x="20" y="30">one label</text><text x="25" y="32">another label</text>
        <text x="180" y="60">far too long</text>
        <text x="20" y="80">under</text><rect x="10" y="65" width="80" height="20" fill="#888"/>
        <text x="120" y="95">good</text></svg>"##;
    std::fs::write(&file, text).unwrap();
    if let Some(mut found) = faults(&file) {
        found.sort();
        let wanted = [
            "\"another label\" runs into \"one label\"",
            "\"far too long\" is cut off",
            "\"under\" is covered by a rect",
        ];
        assert_eq!(found, wanted);
    }
}

#[test]
fn committed_figures_look_right() {
    for folder in ["docs", "benches/results"] {
        let mut files: Vec<PathBuf> =
            std::fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.retain(|file| file.extension().is_some_and(|e| e == "svg"));
        files.sort();
        files.iter().for_each(|file| looks_right(file));
    }
}

#[test]
fn the_page_of_bounds_looks_right() {
    let folder = tempfile::tempdir().unwrap();
    let skin = root().join("launch/skins/baro-grid.toml");
    finish(Command::new(program("dermis")).arg("bounds").arg(skin).arg("--out").arg(folder.path()));
    looks_right(&folder.path().join("theory.html"));
}

/// A row of taxels tells where along it, and not where across: the page says so, and shows numbers where there are any.
#[test]
fn the_page_of_a_sweep_looks_right_with_and_without_a_position() {
    for (flags, determined) in [(&["--line"][..], true), (&[], false)] {
        let folder = tempfile::tempdir().unwrap();
        let mut sweep = Command::new(program("dermis"));
        sweep.arg("sweep").arg(root().join("launch/skins/baro-line.toml")).args(["--vary", "depth"]);
        finish(sweep.args(flags).arg("--out").arg(folder.path()));
        let file = folder.path().join("design.html");
        let page = std::fs::read_to_string(&file).unwrap();
        assert!(!page.contains("NaN") && !page.contains("inf "), "{}", file.display());
        assert_eq!(page.contains("not determined"), !determined);
        assert_eq!(page.contains("no value is finite"), !determined);
        looks_right(&file);
    }
}
