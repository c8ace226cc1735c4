//! Pages and figures in a real browser: nothing is cut off, no label is covered or runs into another, nothing runs out of its
//! page. Screenshots stay in the folder of the tests' own files, for people.
#![expect(clippy::unwrap_used, reason = "a panic is the report of a failed test")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use dermis_integration_tests::{finish, json, program, root};

/// What a browser says of a page, as JSON: faults that a reader would see.
const LOOK: &str = r#"
<pre id="found" hidden>[]</pre>
<script>
addEventListener("load", () => {
  const faults = [];
  const box = e => e.getBoundingClientRect();
  const page = document.documentElement;
  if (page.scrollWidth > page.clientWidth + 1) faults.push("the page is wider than its window");
  const outermost = e => { while (e.ownerSVGElement) e = e.ownerSVGElement; return e; };
  const texts = [...document.querySelectorAll("svg text")].filter(t => t.textContent.trim() && box(t).width > 0);
  const quoted = t => JSON.stringify(t.textContent.trim());
  for (const text of texts) {
    const own = box(text), frame = box(outermost(text));
    if (own.left < frame.left - 1 || own.right > frame.right + 1 || own.top < frame.top - 1 || own.bottom > frame.bottom + 1)
      faults.push(quoted(text) + " is cut off");
    const top = document.elementFromPoint((own.left + own.right) / 2, (own.top + own.bottom) / 2);
    const area = top && top.tagName.toLowerCase() !== "text" && ["rect", "image", "path", "polygon"].includes(top.tagName.toLowerCase());
    if (area && (top.compareDocumentPosition(text) & Node.DOCUMENT_POSITION_PRECEDING))
      faults.push(quoted(text) + " is covered by a " + top.tagName);
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
      faults.push(quoted(texts[i]) + " runs into " + quoted(texts[j]));
  document.getElementById("found").textContent = JSON.stringify(faults);
});
</script>
"#;

/// Every colour that a browser shows on a page, as JSON.
const COLOURS: &str = r#"
<pre id="found" hidden>[]</pre>
<script>
addEventListener("load", () => {
  const seen = new Set();
  for (const element of document.querySelectorAll("body, body *:not(script)")) {
    const style = getComputedStyle(element);
    for (const colour of [style.fill, style.stroke, style.color, style.backgroundColor]) seen.add(colour);
  }
  document.getElementById("found").textContent = JSON.stringify([...seen]);
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

/// What a script finds on a page or an SVG, which it writes into an element `found`. Keeps a screenshot, where one is asked for.
fn found(browser: &Path, file: &Path, script: &str, screenshot: Option<&Path>) -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(file).unwrap();
    // A figure by itself stands in a page of its own; a page gets the script at its end.
    let seen = folder.path().join("page.html");
    let (head, tail) = text.rsplit_once("</body>").unwrap_or((&text, ""));
    std::fs::write(&seen, format!("<!doctype html>\n{head}{script}{tail}")).unwrap();
    let mut arguments = vec!["--dump-dom".to_owned()];
    arguments.extend(screenshot.map(|shot| format!("--screenshot={}", shot.display())));
    let dom = open(browser, &seen, &arguments);
    let found =
        dom.rsplit_once("<pre id=\"found\" hidden=\"\">").and_then(|(_, rest)| rest.split_once("</pre>"));
    let (found, _) = found.unwrap_or_else(|| panic!("the browser did not show {}", file.display()));
    let found = found.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    serde_json::from_str(&found).unwrap()
}

/// What is wrong with how a page or an SVG looks; `None` where there is no browser. Keeps a screenshot.
fn faults(file: &Path) -> Option<Vec<String>> {
    let browser = browser()?;
    let shots = Path::new(env!("CARGO_TARGET_TMPDIR")).join("screenshots");
    std::fs::create_dir_all(&shots).unwrap();
    let name = file.file_stem().unwrap().to_string_lossy().into_owned();
    let shot = shots.join(format!("{name}-{}.png", std::process::id()));
    let found = found(&browser, file, LOOK, Some(&shot));
    assert!(std::fs::metadata(&shot).unwrap().len() > 1000, "{} is empty", shot.display());
    std::fs::rename(&shot, shots.join(format!("{name}.png"))).unwrap();
    Some(found)
}

/// Colours on a page or an SVG that are far more red than anything else; `None` where there is no browser.
fn deep_reds(file: &Path) -> Option<Vec<String>> {
    let mut colours = found(&browser()?, file, COLOURS, None);
    colours.retain(|colour| {
        let channels = colour.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse::<i32>().ok());
        matches!(channels.collect::<Vec<_>>()[..], [red, green, blue, ..] if red - green.max(blue) > 100)
    });
    Some(colours)
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
fn a_deep_red_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("red.svg");
    let text = r##"<svg xmlns="http://www.w3.org/2000/svg" width="200" height="100">
        <rect width="80" height="20" fill="#B2182B"/><rect width="80" height="20" fill="#F4A582"/></svg>"##;
    std::fs::write(&file, text).unwrap();
    if let Some(found) = deep_reds(&file) {
        assert_eq!(found, ["rgb(178, 24, 43)"]);
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
    looks_right(&folder.path().join("bounds.html"));
}

fn dermis(arguments: &[&str]) -> Command {
    let mut command = Command::new(program("dermis"));
    command.current_dir(root()).stdin(Stdio::null()).args(arguments);
    command
}

/// Looks at a page in this folder, whose screenshot is kept under this name; the page's text.
fn seen(folder: &Path, page: &str, name: &str) -> String {
    let file = folder.join(name).with_extension("html");
    std::fs::rename(folder.join(page), &file).unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(!text.contains("NaN") && !text.contains("inf "), "{}", file.display());
    looks_right(&file);
    text
}

/// A row of taxels tells where along it, and not where across: the page says so, and shows numbers where there are any.
#[test]
fn the_page_of_a_sweep_looks_right_with_and_without_a_position() {
    for (flags, determined, name) in [(&["--line"][..], true, "sweep"), (&[], false, "sweep-undetermined")] {
        let folder = tempfile::tempdir().unwrap();
        let mut sweep = dermis(&["sweep", "launch/skins/baro-line.toml", "--vary", "depth"]);
        finish(sweep.args(flags).arg("--out").arg(folder.path()));
        let page = seen(folder.path(), "sweep.html", name);
        for sentence in
            ["position not determined", "There is no figure of the position", "There is no figure of Ω"]
        {
            assert_eq!(page.contains(sentence), !determined, "{name}: {sentence}");
        }
        assert_eq!(page.matches("<svg").count(), if determined { 4 } else { 2 });
    }
}

#[test]
fn the_page_of_a_placement_looks_right() {
    let folder = tempfile::tempdir().unwrap();
    let mut place = dermis(&["optimize-placement", "launch/skins/baro-grid.toml", "--budget", "3"]);
    place.args([
        "--method",
        "crlb",
        "--method",
        "pca-qr",
        "--locations",
        "60",
        "--searched",
        "30",
        "--repeats",
        "2",
    ]);
    finish(place.arg("--out").arg(folder.path()));
    let page = seen(folder.path(), "placement.html", "placement");
    assert!(page.contains("can be built") && page.contains("pca-qr"), "{page}");
}

const SHIN: &str = "launch/skins/hapdef-shin.toml";

/// A plan of short presses from these steps.
fn plan(folder: &Path, name: &str, head: &str, steps: &[&str]) -> PathBuf {
    let idle = "kind = \"idle\"\nduration = 1.0";
    let steps: String = [idle].iter().chain(steps).map(|step| format!("[[steps]]\n{step}\n")).collect();
    let file = folder.join(name).with_extension("toml");
    let text = format!("schema = \"dermis-plan/1\"\nname = \"{name}\"\nseed = 3\n{head}\n{steps}");
    std::fs::write(&file, text).unwrap();
    file
}

/// A bag of this plan.
fn recorded(skin: &Path, plan: &Path) -> PathBuf {
    let bag = plan.with_extension("bag");
    finish(dermis(&["collect", "--plan"]).arg(plan).arg("--out").arg(&bag).arg(skin));
    bag
}

/// Few epochs and few contacts: what is learned is bad, and shown like any other.
#[test]
fn pages_of_several_contacts_by_simulation_look_right() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A coarser mesh: seconds in place of minutes.
    let skin = folder.join("shin.toml");
    let text = std::fs::read_to_string(root().join(SHIN)).unwrap();
    assert!(text.contains("spacing = 0.00245"));
    std::fs::write(&skin, text.replace("spacing = 0.00245", "spacing = 0.008")).unwrap();
    let settings = folder.join("settings.toml");
    let few = |name: &str| format!("{name} = {{ hidden = [16] }}\n{name}_training = {{ epochs = 2 }}\n");
    let networks: String = ["transfer", "reconstruction", "sensitivity"].map(few).concat();
    let text = format!(
        "most = 300\n[scenes]\nlocations = 60\n[pipeline]\neach = 0\nsums = 100\nsamples = [100, 100, 100, 100]\n{networks}\
         [table]\nsamples = [60, 60, 60, 60]\ntests = 30\nnetwork = {{ hidden = [16] }}\ntraining = {{ epochs = 2 }}\n"
    );
    std::fs::write(&settings, text).unwrap();

    let table = folder.join("table");
    let mut make = dermis(&["real2sim", "table", "--settings"]);
    finish(make.arg(&settings).arg("--out").arg(&table).arg(&skin));
    seen(&table, "table.html", "real2sim-table");

    let head = "diameter = 0.010\nregion = [[-0.085, -1.0, -1.0], [0.085, 1.0, 1.0]]\n\
                timing = { approach = [0.002, 0.004], load = [0.01, 0.02], hold = [0.01, 0.02], unload = [0.01, 0.02], \
                gap = [0.005, 0.01] }";
    let singles = "kind = \"presses\"\ncount = 24\nforce = [2.0, 34.3]";
    let doubles =
        "kind = \"multi\"\ncount = 24\ncontacts = [2, 2]\ndistance = [0.012, 0.075]\nforce = [2.0, 34.3]";
    let learned = recorded(&skin, &plan(folder, "singles", head, &[singles]));
    let presses = recorded(&skin, &plan(folder, "doubles", head, &[doubles, singles]));
    let (bundle, out) = (folder.join("bundle"), folder.join("comparison"));
    let mut train = dermis(&["real2sim", "train", "--skin"]);
    train.arg(&skin).arg("--settings").arg(&settings).arg("--out").arg(&bundle);
    finish(train.arg(&learned));
    let mut compare = dermis(&[
        "real2sim",
        "compare",
        "--most",
        "4",
        "--learn",
        "100",
        "--vectors",
        "0",
        "--contacts",
        "1",
    ]);
    compare.arg("--skin").arg(&skin).arg("--model").arg(&bundle).arg("--train").arg(&learned);
    finish(compare.arg("--out").arg(&out).arg(&presses));
    let page = seen(&out, "comparison.html", "real2sim-comparison");
    assert_eq!(page.matches("<svg").count(), 2, "errors by force, and a map");
}

#[test]
fn the_page_of_a_comparison_looks_right() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let skin = root().join("launch/skins/baro-grid.toml");
    let head = "diameter = 0.004";
    let bag = recorded(
        &skin,
        &plan(folder, "presses", head, &["kind = \"presses\"\ncount = 60\nforce = [0.1, 1.5]"]),
    );
    let (bundle, out) = (folder.join("bundle"), folder.join("comparison"));
    let mut train =
        dermis(&["train", "--config", "launch/train/baro-grid.toml", "--members", "1", "--epochs", "2"]);
    finish(train.arg("--skin").arg(&skin).arg("--out").arg(&bundle).arg(&bag));
    let mut compare = dermis(&["compare", "--learn", "200", "--vectors", "50", "--skin"]);
    finish(compare.arg(&skin).arg("--model").arg(&bundle).arg("--out").arg(&out).arg(&bag));
    seen(&out, "comparison.html", "comparison");
}

/// Maps and their colour bars are pale where the sentence above them says that there is no gap.
#[test]
fn the_page_of_no_gap_has_no_deep_red() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let skin = root().join("launch/skins/baro-line.toml");
    let head = "diameter = 0.004\n\
                timing = { approach = [0.05, 0.1], load = [0.05, 0.1], hold = [0.3, 0.6], unload = [0.05, 0.1], gap = [0.1, 0.3] }";
    let steps = [
        "kind = \"presses\"\ncount = 100\nforce = [0.1, 1.0]",
        "kind = \"grid\"\npitch = 0.004\nforces = [0.2, 0.6]\nrepeats = 2",
    ];
    let bag = recorded(&skin, &plan(folder, "designed", head, &steps));
    let mut diagnose = dermis(&["gap", "diagnose", "--json", "--resamples", "4", "--skin"]);
    diagnose.arg(&skin).arg("--real").arg(&bag).arg("--cache").arg(folder.join("kept"));
    let report = json(&finish(diagnose.arg("--out").arg(folder.join("out"))));
    assert_eq!(report["verdict"], "no-gap-beyond-noise", "{}", report["sentence"]);
    let page = seen(&folder.join("out"), "report.html", "no-gap");
    assert!(page.contains("before: mean") || page.contains("There is no map"), "{page}");
    if let Some(found) = deep_reds(&folder.join("out/no-gap.html")) {
        assert_eq!(found, Vec::<String>::new());
    }
}
