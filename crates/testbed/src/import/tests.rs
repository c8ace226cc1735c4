use std::{
    fs::{self, File},
    io::Write as _,
};

use dermis_bag::BagReader;
use dermis_msgs::{geometry_msgs::msg::PointStamped, msg::SkinGeometry};

use super::*;

mod conductive;

/// Folder of other people's recordings, where there is one.
fn data(part: &str) -> Option<PathBuf> {
    let root = std::env::var_os("DERMIS_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let path = root.join(part);
    if !path.exists() {
        println!("skipped: no recording at {} (DERMIS_DATA names the folder)", path.display());
        return None;
    }
    Some(path)
}

struct Imported {
    report: ImportReport,
    frames: Vec<TaxelFrame>,
    layout: ChannelLayout,
    truths: Vec<Indentation>,
    bag: BagReader,
    _out: tempfile::TempDir,
}

fn import(path: &Path) -> Imported {
    let out = tempfile::tempdir().unwrap();
    let report = auto(path, &out.path().join("bag")).unwrap();
    let bag = BagReader::open(&report.bag.path).unwrap();
    let frames: Vec<_> =
        bag.read::<TaxelFrame>("taxels").unwrap().map(|read| read.unwrap().message).collect();
    let truths: Vec<_> =
        bag.read::<Indentation>("ground_truth").unwrap().map(|read| read.unwrap().message).collect();
    // Whatever is known of the skin: the bag names its channels.
    let geometry = bag.read_only_topic::<SkinGeometry>().unwrap().next().unwrap().unwrap().message;
    let layout = ChannelLayout::of(&geometry);
    assert_eq!(frames.len(), truths.len());
    assert_eq!(frames.len() as u64, report.readings + report.untouched);
    for (index, (frame, truth)) in frames.iter().zip(&truths).enumerate() {
        assert_eq!(frame.header, truth.header, "labels carry the stamp of their reading");
        assert_eq!(frame.sequence, index as u64);
        assert_eq!(frame.values.len(), layout.channels.len());
        assert_eq!(frame.layout_id, layout.id());
        assert!(truth.phase != Indentation::PHASE_IDLE || truth.contacts.is_empty());
    }
    assert!(frames.is_sorted_by_key(|frame| frame.header.stamp.as_nanos()));
    Imported { report, frames, truths, layout, bag, _out: out }
}

/// Measured readings, without the repeated ones of the untouched skin.
fn recorded(imported: &Imported) -> Vec<(&TaxelFrame, &Indentation)> {
    imported
        .frames
        .iter()
        .zip(&imported.truths)
        .filter(|(_, truth)| truth.phase != Indentation::PHASE_IDLE)
        .collect()
}

fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance
}

#[track_caller]
fn assert_row(values: &[f32], microtesla: &[f64]) {
    for (value, expected) in values.iter().zip(microtesla) {
        assert!(close(f64::from(*value) * 1e6, *expected, 1e-3), "{values:?} {microtesla:?}");
    }
}

#[test]
fn eflesh_positions() {
    let Some(path) = data("eflesh/spatial_resolution/20250316_155729_probe") else { return };
    let imported = import(&path);
    let report = &imported.report;
    assert_eq!((report.readings, report.untouched), (4805, 4 * 4805));
    assert_eq!((report.presses, report.locations, report.channels), (4805, 961, 15));
    assert!(close(report.worst_mismatch.unwrap(), 0.008_201_6, 1e-6));

    let rows = recorded(&imported);
    let (first, truth) = rows[0];
    assert_eq!(first.header.stamp.as_nanos() / 1000, 1_742_155_052_516_165);
    assert_row(
        &first.values,
        &[662.400_024_414_062_5, -830.400_024_414_062_5, 7_647.200_195_312_5, 916.800_048_828_125],
    );
    let layout = &imported.layout;
    assert_eq!((layout.unit.as_str(), layout.channels[14].as_str()), ("T", "m4.z"));
    let contact = &truth.contacts[0];
    assert!(close(contact.position.x, -0.015, 1e-9) && close(contact.position.y, -0.015, 1e-9));
    assert!(
        contact.force.z.is_nan() && contact.depth.is_nan() && contact.force_components == Contact::FORCE_NONE
    );
    assert_eq!((truth.press, truth.location, truth.repeat), (0, 0, 0));
    assert_eq!((truth.session.as_str(), truth.phase), ("20250316_155729_probe", Indentation::PHASE_HOLD));

    let (last, truth) = rows[4804];
    assert_eq!(last.header.stamp.as_nanos() / 1000, 1_742_175_464_271_292);
    assert_row(&last.values, &[230.400_009_155_273_44, -256.800_018_310_546_9, 7_221.279_785_156_25]);
    assert!(
        close(truth.contacts[0].position.x, 0.015, 1e-9) && close(truth.contacts[0].position.y, 0.015, 1e-9)
    );
    assert_eq!((truth.press, truth.location), (4804, 960));

    // The baseline of the first press: sensor minus sensor_post_baselines.
    let idle = &imported.frames[0];
    assert!(imported.truths[0].contacts.is_empty());
    assert_row(&idle.values, &[384.000_004_4, -451.200_024_4, 7_430.368_165_3]);
    assert_eq!(first.header.stamp.as_nanos() - idle.header.stamp.as_nanos(), 800_000_000);
    assert_eq!(imported.frames[3].values, idle.values);

    let probe = imported.bag.read::<PointStamped>("probe").unwrap().next().unwrap().unwrap().message;
    assert!(close(probe.point.z, 0.142_384_964, 1e-12) && close(probe.point.x, 0.274, 1e-12));
    assert_eq!(imported.bag.read_only_topic::<SkinGeometry>().unwrap().count(), 1);
    assert!(imported.bag.custom()["dermis.import.assumed"].contains("microtesla"));
}

#[test]
fn eflesh_normal_force() {
    let Some(path) = data("eflesh/normal_force/20250401_014340_probe") else { return };
    let imported = import(&path);
    assert_eq!((imported.report.readings, imported.report.untouched), (3600, 40));
    assert_eq!((imported.report.presses, imported.report.locations), (10, 1));
    let rows = recorded(&imported);
    assert_eq!(rows.iter().map(|(_, truth)| truth.press).max(), Some(9));
    assert_row(&rows[0].0.values, &[604.800_048_828_125, 158.400_009_155_273_44, 9_439.935_546_875]);
    assert_row(
        &rows[3599].0.values[12..],
        &[-151.200_012_207_031_25, 1_992.000_122_070_312_5, 11_921.887_695_312_5],
    );
    // Nothing touches before the load cell rises, 22 rows into the first stroke.
    assert!(rows[..20].iter().all(|(_, t)| t.contacts.is_empty() && t.phase == Indentation::PHASE_APPROACH));
    // Row 181 of states.csv: 3481.25 gf at the bottom, 12 mm down.
    let (_, truth) = rows[180];
    let contact = &truth.contacts[0];
    assert!(close(contact.force.z, -3481.25 * 9.806_65e-3, 1e-9) && contact.force.x == 0.0);
    assert_eq!(contact.force_components, Contact::FORCE_NORMAL);
    assert!(close(contact.depth, 0.0118, 2e-4), "{contact:?}");
    assert!(contact.position.x.is_nan());
    // Row 151: the load cell had a reading; row 152: it had none.
    assert!(close(rows[150].1.contacts[0].force.z, -3239.12 * 9.806_65e-3, 1e-9));
    assert_eq!(rows[150].1.phase, Indentation::PHASE_LOAD);
    assert!(rows[153].1.contacts[0].force.z.is_nan());
    assert_eq!(rows[210].1.phase, Indentation::PHASE_UNLOAD);
    assert!(rows[359].1.contacts.is_empty());
}

#[test]
fn eflesh_shear_force() {
    let Some(path) = data("eflesh/shear_force/20250416_200533_probe") else { return };
    let imported = import(&path);
    assert_eq!((imported.report.readings, imported.report.presses, imported.report.channels), (7200, 10, 30));
    let rows = recorded(&imported);
    assert_row(&rows[0].0.values, &[3_393.000_244_140_625, -991.200_012_207_031_2]);
    let contact = &rows[360].1.contacts[0];
    assert!(close(contact.force.x, -1813.99 * 9.806_65e-3, 1e-9) && contact.force.z.is_nan());
    let mut geometry = imported.bag.read::<dermis_msgs::msg::SkinGeometry>("skin_geometry").unwrap();
    let geometry = geometry.next().unwrap().unwrap().message;
    let skin =
        SkinDescription::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../launch/skins/eflesh-shear.toml"))
            .unwrap();
    assert_eq!((geometry.skin.as_str(), geometry.channels.len()), ("eflesh-shear", 30));
    assert_eq!(geometry.points.len(), skin.surface().points.len());
    assert!(geometry.channels.iter().zip(skin.channels()).all(|(a, b)| *a == b.name));
}

#[test]
fn tactile_fsi_line_presses() {
    let Some(path) = data("tactile_fsi/presses/1D_air_dia1_0mm.xlsx") else { return };
    let imported = import(&path);
    assert_eq!((imported.report.readings, imported.report.untouched), (697, 4));
    assert_eq!((imported.report.presses, imported.report.locations), (697, 41));
    let (frame, truth) = (&imported.frames[4], &imported.truths[4]);
    assert!(
        close(f64::from(frame.values[0]), 783.538_443, 1e-3)
            && close(f64::from(frame.values[1]), 678.483_797, 1e-3)
    );
    let contact = &truth.contacts[0];
    assert!(close(contact.position.x, -0.040, 1e-12) && close(contact.force.z, -1.809_210_091_5, 1e-9));
    assert!(close(contact.depth, 0.0015, 1e-12));
    let (frame, truth) = (&imported.frames[700], &imported.truths[700]);
    assert!(close(f64::from(frame.values[1]), 1_424.189_726, 1e-3));
    assert!(close(truth.contacts[0].position.x, 0.040, 1e-12) && truth.location == 40);
    assert_eq!(imported.layout.channels, ["pl", "pr"]);
}

#[test]
fn tactile_fsi_pad_presses() {
    let Some(path) = data("tactile_fsi/presses/2D_6060_learning_data.xlsx") else { return };
    let imported = import(&path);
    assert_eq!((imported.report.readings, imported.report.locations), (15_376, 961));
    let (frame, truth) = (&imported.frames[4], &imported.truths[4]);
    assert_eq!(imported.layout.channels, ["pl", "pr", "tl", "tr"]);
    assert!(
        close(f64::from(frame.values[0]), 345.390_349, 1e-3) && close(f64::from(frame.values[3]), 4.07, 1e-6)
    );
    let contact = &truth.contacts[0];
    assert!(close(contact.position.x, -0.030, 1e-12) && close(contact.position.y, -0.030, 1e-12));
    assert!(close(contact.force.z, -0.337_676_312_8, 1e-9) && contact.depth.is_nan());
    let last = imported.truths.last().unwrap();
    assert!(
        close(last.contacts[0].position.y, 0.030, 1e-12)
            && close(last.contacts[0].force.z, -5.342_583_388, 1e-8)
    );
    assert_eq!(imported.truths.iter().map(|truth| truth.repeat).max(), Some(15));
}

#[test]
fn tactile_fsi_time_series() {
    let Some(path) = data("tactile_fsi/raw_timeseries/1D_underwater_10mm.npz") else { return };
    let imported = import(&path);
    assert_eq!((imported.report.readings, imported.report.untouched), (8000, 0));
    let times: Vec<i64> = imported.frames.iter().map(|frame| frame.header.stamp.as_nanos()).collect();
    assert!(times.windows(2).all(|pair| pair[1] - pair[0] == 10_000_000));
    // 5000 Pa/V around the rest at 2.5 V and, at most, 3.523 898 4 V on the right.
    let right = imported.frames.iter().map(|frame| frame.values[1]).fold(f32::MIN, f32::max);
    assert!(close(f64::from(right), 17_619.492, 0.01), "{right}");
    let forces: Vec<f64> = imported.truths.iter().map(|truth| -truth.contacts[0].force.z).collect();
    let start = forces[..100].iter().sum::<f64>() / 100.0;
    // -1.3578185 V at most, from a zero near -0.0737 V.
    let most = forces.iter().copied().fold(f64::MIN, f64::max);
    assert!(
        close(start, 0.0, 1e-12) && close(most, 4.1448 * (1.357_818_5 - 0.073_7), 0.01),
        "{start} {most}"
    );
}

#[test]
fn everything_in_a_folder_is_found() {
    let Some(path) = data("eflesh") else { return };
    assert_eq!(recordings(&path).unwrap().len(), 5);
    let error = auto(&path, Path::new("bag")).unwrap_err().to_string();
    assert!(
        error.contains("holds 5 recordings, and a bag is made of one: name one of them, e.g. "),
        "{error}"
    );
    let Some(path) = data("tactile_fsi") else { return };
    // Simulation results lie beside them.
    assert_eq!(recordings(&path).unwrap().len(), 7 + 8);
}

fn run(dir: &Path, sensor: &str, post: Option<&str>, states: &str) -> PathBuf {
    let run = dir.join("20250101_run");
    fs::create_dir_all(&run).unwrap();
    fs::write(run.join("sensor.csv"), sensor).unwrap();
    fs::write(run.join("states.csv"), states).unwrap();
    if let Some(post) = post {
        fs::write(run.join("sensor_post_baselines.csv"), post).unwrap();
    }
    run
}

fn rows(times: &[f64], value: f64) -> String {
    times.iter().map(|time| format!("{time}{}\n", format!(",{value}").repeat(15))).collect()
}

#[test]
fn a_run_without_baselines_says_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let run = run(
        dir.path(),
        &rows(&[1e9, 1e9 + 4.0], 2.4),
        None,
        "1000000000.002,10,20,5\n1000000004.001,11,20,5\n\n",
    );
    let report = eflesh(&run, &dir.path().join("out"), &mut |_, _| {}).unwrap();
    let text = report.to_string().replace(&dir.path().display().to_string(), "");
    insta::assert_snapshot!(text, @"
    imported  /20250101_run
    data set  eFlesh, spatial resolution (Pattabiraman et al. 2025, MIT licence)
    bag       /out
    readings  2 pressed, 0 untouched, 15 channels in T
    presses   2 at 2 locations
    matching  every reading has a robot state within 2.0 ms
    assumed   sensor.csv is in microtesla: its steps are those of the MLX90393's data sheet; values here are in T
    assumed   the origin is the middle of the pressed grid, robot x 10.5 and y 20 mm; axes along the robot's, z out of the surface
    missing   temperature, diameter of the indenter
    missing   force, and the height of first contact, so depth is NaN; topic probe keeps the robot's height
    missing   sensor_post_baselines.csv, and so every reading of the untouched pad
    ");
    let error = eflesh(&run, &dir.path().join("out"), &mut |_, _| {}).unwrap_err().to_string();
    assert!(
        error.ends_with("exists already: bags are never written over, give another name or remove it"),
        "{error}"
    );
}

#[test]
fn mistakes_in_a_run_are_named() {
    let states = "1000000000,10,20,5\n1000000004,11,20,5\n";
    let good = rows(&[1e9, 1e9 + 4.0], 2.4);
    let say = |sensor: &str, post: Option<&str>, states: &str| {
        let dir = tempfile::tempdir().unwrap();
        let run = run(dir.path(), sensor, post, states);
        let error = auto(&run, &dir.path().join("out")).unwrap_err().to_string();
        error.replace(&dir.path().display().to_string(), "")
    };
    insta::assert_snapshot!(say(&good.replacen("2.4", "2,4", 1), None, states), @"/20250101_run/sensor.csv, line 2: has 16 columns, the lines before have 17");
    insta::assert_snapshot!(say(&good.replace("1000000004,2.4,2.4", "1000000004,2.4,oops"), None, states), @r#"/20250101_run/sensor.csv, line 2, column 3: "oops" is not a number"#);
    insta::assert_snapshot!(say(&good.replace("1000000004,2.4", "1000000004,nan"), None, states), @"/20250101_run/sensor.csv, line 2, column 2: NaN is not finite");
    insta::assert_snapshot!(say(&good.replace("1000000004,", "999999999,"), None, states), @"/20250101_run/sensor.csv, line 2, column 1: time runs back from 1000000000 to 999999999");
    insta::assert_snapshot!(say(&good.replace("1000000004,", "-4,"), None, states), @"/20250101_run/sensor.csv, line 2, column 1: -4 is not a time in seconds since 1970");
    insta::assert_snapshot!(say("", None, states), @"/20250101_run/sensor.csv: holds no rows");
    insta::assert_snapshot!(say("1000000000,1,2,3\n", None, states), @"/20250101_run/sensor.csv: has 4 columns; known are 16 and 31: time and three axes of 5 or 10 magnetometers");
    insta::assert_snapshot!(say(&good, None, "1000000000,10\n"), @"/20250101_run/states.csv: has 2 columns; known are 4 (time, x, y, z) and, with weight, 5");
    insta::assert_snapshot!(say(&good, None, "1000000000,10,20,5\n"), @"/20250101_run/sensor.csv, row 2: the nearest robot state in states.csv is 4.000 s away: the files don't belong together");
    insta::assert_snapshot!(say(&good, Some(&rows(&[1e9], 1.0)), states), @"/20250101_run/sensor_post_baselines.csv: has 1 rows of 16 columns where sensor.csv has 2 of 16");
    insta::assert_snapshot!(say(&good, Some(&rows(&[1e9, 1e9 + 3.0], 1.0)), states), @"/20250101_run/sensor_post_baselines.csv, row 2, column 1: time 1000000003 is not that of the same row in sensor.csv, 1000000004");

    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("notes.txt"), "x").unwrap();
    let error = auto(dir.path(), &dir.path().join("out")).unwrap_err().to_string();
    insta::assert_snapshot!(error.replace(&dir.path().display().to_string(), "FOLDER"), @"FOLDER is no recording that can be imported: known are an eFlesh run (a folder with sensor.csv and states.csv), a hydrogel skin (a folder with inp_*.csv and out_*.csv), impedance tomography of tanks (*Hz.csv, .txt that begins with #MEAS, .npz with phantomdata, .mat of MATLAB's level 5), and tactile_fsi files (presses as .xlsx, time series as .npz), or a folder of these");
}

/// A workbook of one sheet; text cells are those that are no numbers.
fn workbook(path: &Path, rows: &[&[&str]]) {
    let mut cells = String::new();
    for (index, row) in rows.iter().enumerate() {
        cells.push_str(&format!("<row r=\"{}\">", index + 1));
        for (column, text) in row.iter().enumerate() {
            let name = format!("{}{}", char::from(b'A' + column as u8), index + 1);
            if text.is_empty() {
                continue;
            }
            if text.parse::<f64>().is_ok() {
                cells.push_str(&format!("<c r=\"{name}\"><v>{text}</v></c>"));
            } else {
                cells.push_str(&format!("<c r=\"{name}\" t=\"inlineStr\"><is><t>{text}</t></is></c>"));
            }
        }
        cells.push_str("</row>");
    }
    let mut archive = zip::ZipWriter::new(File::create(path).unwrap());
    let schema = "http://schemas.openxmlformats.org";
    for (name, text) in [
        (
            "[Content_Types].xml",
            format!(
                "<Types xmlns=\"{schema}/package/2006/content-types\"><Default Extension=\"xml\" ContentType=\"application/xml\"/></Types>"
            ),
        ),
        (
            "_rels/.rels",
            format!(
                "<Relationships xmlns=\"{schema}/package/2006/relationships\"><Relationship Id=\"rId1\" Type=\"{schema}/officeDocument/2006/relationships/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml",
            format!(
                "<workbook xmlns=\"{schema}/spreadsheetml/2006/main\" xmlns:r=\"{schema}/officeDocument/2006/relationships\"><sheets><sheet name=\"Ark1\" sheetId=\"1\" r:id=\"rId1\"/></sheets></workbook>"
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels",
            format!(
                "<Relationships xmlns=\"{schema}/package/2006/relationships\"><Relationship Id=\"rId1\" Type=\"{schema}/officeDocument/2006/relationships/worksheet\" Target=\"worksheets/sheet1.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/worksheets/sheet1.xml",
            format!(
                "<worksheet xmlns=\"{schema}/spreadsheetml/2006/main\"><sheetData>{cells}</sheetData></worksheet>"
            ),
        ),
    ] {
        archive.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(text.as_bytes()).unwrap();
    }
    archive.finish().unwrap();
}

#[test]
fn mistakes_in_a_sheet_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("1D_test.xlsx");
    let mut trial = 0;
    let mut import = |rows: &[&[&str]]| {
        workbook(&file, rows);
        trial += 1;
        tactile_fsi(&file, &dir.path().join(trial.to_string()))
            .map_err(|error| error.to_string().replace(&dir.path().display().to_string(), ""))
    };
    let header: &[&str] = &["X", "Pl", "Pr", "F", "depth"];
    let press: &[&str] = &["10", "1.5", "0.5", "2", "1.25"];

    let report = import(&[header, press, &["12", "1", "1", "1", ""], &["", "", "", "", ""]]).unwrap();
    assert_eq!((report.presses, report.locations), (2, 2));
    assert!(report.missing.contains(&"depth".to_owned()));
    insta::assert_snapshot!(import(&[&["X", "Pl", "F"], press]).unwrap_err(), @"/1D_test.xlsx: sheet Ark1 has no column Pr; its first row holds: X, Pl, F");
    insta::assert_snapshot!(import(&[header, press, &["12", "high", "1", "1", "1"]]).unwrap_err(), @r#"/1D_test.xlsx, cell B3 (column Pl): "high" is not a number"#);
    insta::assert_snapshot!(import(&[header, &["12", "1", "", "1", "1"]]).unwrap_err(), @"/1D_test.xlsx, cell C2 (column Pr): is empty where a number belongs");
    insta::assert_snapshot!(import(&[&["X", "Y", "Pl", "Pr", "F"], press]).unwrap_err(), @"/1D_test.xlsx: sheet Ark1 has no column Tl; its first row holds: X, Y, Pl, Pr, F");
    insta::assert_snapshot!(import(&[header]).unwrap_err(), @"/1D_test.xlsx: sheet Ark1 holds no presses below its first row");

    fs::write(&file, "not a workbook").unwrap();
    let error = tactile_fsi(&file, dir.path()).unwrap_err().to_string();
    assert!(error.contains("1D_test.xlsx: is not a readable .xlsx workbook: "), "{error}");
    let other = dir.path().join("a.csv");
    fs::write(&other, "1").unwrap();
    assert!(matches!(tactile_fsi(&other, dir.path()), Err(ImportError::Unknown { .. })));
}

/// An array of an `.npz` archive, by its format's description.
fn npy(kind: &str, shape: &str, bytes: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    while !(header.len() + 11).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(bytes);
    out
}

#[test]
fn mistakes_in_a_time_series_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("1D_test.npz");
    let mut trial = 0;
    let mut import = |volts: &[f32], shape: &str, rate: f64| {
        let mut archive = zip::ZipWriter::new(File::create(&file).unwrap());
        let bytes: Vec<u8> = volts.iter().flat_map(|value| value.to_le_bytes()).collect();
        for (name, array) in
            [("volts", npy("<f4", shape, &bytes)), ("fs", npy("<f8", "()", &rate.to_le_bytes()))]
        {
            archive.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            archive.write_all(&array).unwrap();
        }
        archive.finish().unwrap();
        trial += 1;
        tactile_fsi(&file, &dir.path().join(trial.to_string()))
            .map_err(|error| error.to_string().replace(&dir.path().display().to_string(), ""))
    };
    let report = import(&[0.0, 2.5, 2.5, -1.0, 3.0, 2.75], "(2, 3)", 2.0).unwrap();
    assert_eq!(
        (report.readings, report.bag.span),
        (2, Some((1_735_689_600_000_000_000, 1_735_689_600_500_000_000)))
    );
    insta::assert_snapshot!(import(&[0.0, 2.5], "(1, 2)", 100.0).unwrap_err(), @"/1D_test.npz: array volts: its shape is [1, 2] where rows of 3 are expected");
    insta::assert_snapshot!(import(&[0.0, 2.5, 2.5], "(1, 3)", 0.0).unwrap_err(), @"/1D_test.npz: array fs: [0.0] is not one rate in Hz");
    insta::assert_snapshot!(import(&[0.0, 2.5, f32::NAN], "(1, 3)", 100.0).unwrap_err(), @"/1D_test.npz, array volts, row 1, column 3: NaN is not finite");
    insta::assert_snapshot!(import(&[0.0], "(4000000000, 3)", 100.0).unwrap_err(), @"/1D_test.npz: array volts: its shape [4000000000, 3] is larger than a day of samples");
    assert!(import(&[0.0], "(5, 3)", 100.0).unwrap_err().starts_with("/1D_test.npz: array volts: "));

    fs::write(&file, "not an archive").unwrap();
    let error = tactile_fsi(&file, dir.path()).unwrap_err().to_string();
    assert!(error.contains("1D_test.npz: is not a readable .npz archive: "), "{error}");
    let mut archive = zip::ZipWriter::new(File::create(&file).unwrap());
    archive.start_file("other.npy", zip::write::SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    let error = tactile_fsi(&file, dir.path()).unwrap_err().to_string();
    assert!(error.contains("array volts: "), "{error}");
}

#[test]
fn the_skins_are_those_of_the_importers() {
    for (file, text) in [
        ("eflesh.toml", include_str!("../../../../launch/skins/eflesh.toml")),
        ("eflesh-shear.toml", include_str!("../../../../launch/skins/eflesh-shear.toml")),
        ("tactile-fsi-line.toml", include_str!("../../../../launch/skins/tactile-fsi-line.toml")),
        ("tactile-fsi-pad.toml", include_str!("../../../../launch/skins/tactile-fsi-pad.toml")),
    ] {
        SkinDescription::from_toml(text, file).unwrap();
    }
}
