//! Conductive skins and tanks.

use super::*;

/// Folder of the hydrogel skins' recordings, where there is one.
fn e_skins() -> Option<PathBuf> {
    let path = std::env::var_os("DERMIS_E_SKINS").map(PathBuf::from)?;
    if !path.is_dir() {
        println!("skipped: no recordings at {} (DERMIS_E_SKINS names the folder)", path.display());
        return None;
    }
    Some(path)
}

#[test]
fn hydrogel_skins() {
    let Some(path) = e_skins() else {
        println!("skipped: DERMIS_E_SKINS names no folder with the recordings of the hydrogel skins");
        return;
    };
    assert_eq!(recordings(&path).unwrap().len(), 5);
    let imported = import(&path.join("Data/No Pattern"));
    assert_eq!((imported.report.readings, imported.report.untouched), (2500, 10_000));
    assert_eq!((imported.report.locations, imported.report.channels), (2500, 192));
    let (frame, truth) = recorded(&imported)[0];
    assert_eq!(frame.values[..3], [117.8125, 115.0625, 71.625]);
    // Robot x 47.621 of 6.862 to 86.207 mm, y -397.505 of -447.521 to -368.552 mm.
    let contact = &truth.contacts[0];
    assert!(close(contact.position.x, 0.001_086_9, 1e-6) && close(contact.position.y, 0.010_531, 1e-6));
    assert!(contact.force.z.is_nan() && contact.depth.is_nan());
}

/// A folder with tables of these rows.
fn e_skin_folder(inputs: &str, outputs: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("inp_tiny.csv"), inputs).unwrap();
    fs::write(folder.path().join("out_tiny.csv"), outputs).unwrap();
    folder
}

#[test]
fn presses_of_a_hydrogel_skin_are_distinguished_from_the_untouched_skin() {
    let row = |value: &str| vec![value; 192].join(",");
    let inputs = format!("\u{feff}{}\r\n{}\r\n\r\n", row("-3.5"), row("7.0625"));
    let folder = e_skin_folder(&inputs, "\u{feff}0.01,-0.30,0.02\n0.03,-0.36,0.02\n");
    let imported = import(folder.path());
    assert_eq!((imported.report.readings, imported.report.untouched, imported.report.presses), (2, 8, 2));
    let rows = recorded(&imported);
    assert_eq!((rows[0].0.values[0], rows[1].0.values[191]), (-3.5, 7.0625));
    let at = |row: usize| (rows[row].1.contacts[0].position.x, rows[row].1.contacts[0].position.y);
    assert!(close(at(0).0, -0.01, 1e-12) && close(at(0).1, 0.03, 1e-12));
    assert!(close(at(1).0, 0.01, 1e-12) && close(at(1).1, -0.03, 1e-12));
    assert_eq!((rows[1].1.press, rows[1].1.location, rows[1].1.session.as_str()), (1, 1, "tiny"));
    assert!(imported.frames[..4].iter().all(|frame| frame.values.iter().all(|v| *v == 0.0)));
    let probe = imported.bag.read::<PointStamped>("probe").unwrap().next().unwrap().unwrap().message;
    assert!(close(probe.point.y, -0.30, 1e-12));
}

#[test]
fn damaged_tables_of_a_hydrogel_skin_are_refused_by_line_and_column() {
    let row = |value: &str| vec![value; 192].join(",");
    let refusal = |inputs: &str, outputs: &str| {
        let folder = e_skin_folder(inputs, outputs);
        let error = auto(folder.path(), &folder.path().join("bag")).unwrap_err().to_string();
        error.replace(&folder.path().display().to_string(), "DIR")
    };
    insta::assert_snapshot!(refusal(&row("1"), "0,0,0\n1,1,1\n"), @"DIR/inp_tiny.csv: has 1 rows where DIR/out_tiny.csv has 2");
    insta::assert_snapshot!(refusal(&row("x"), "0,0,0\n"), @r#"DIR/inp_tiny.csv, line 1, column 1: "x" is not a finite number"#);
    insta::assert_snapshot!(refusal("1,2,3", "0,0,0\n"), @"DIR/inp_tiny.csv, line 1: has 3 columns, and 192 belong there");
    insta::assert_snapshot!(refusal(&row("1"), "0,0,inf\n"), @r#"DIR/out_tiny.csv, line 1, column 3: "inf" is not a finite number"#);
    insta::assert_snapshot!(refusal("\n", "0,0,0\n"), @"DIR/inp_tiny.csv: holds no rows");
}

#[test]
fn a_tank_whose_electrodes_were_measured() {
    let Some(path) = data("eidors_tanks/ottawa_2008_tanks_20_to_25.npz") else { return };
    let frames = read_tank(&path).unwrap();
    assert_eq!(
        frames.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(),
        ["20", "21", "22", "23", "24", "25"]
    );
    let first = &frames[0];
    assert!(first.readings.len() == 208 && close(first.readings[0], 1.016_264_92, 1e-8));
    let rim = first.rim.as_ref().unwrap();
    assert!(close(rim[0][0], 1.276_576_72, 1e-8) && close(rim[0][1], 0.222_656_63, 1e-8));
    // The squeezed tank is longer than wide.
    let squeezed = frames[3].rim.as_ref().unwrap();
    assert!(squeezed[7][0] < -1.6 && squeezed[11][1].abs() < 1.25);
    let imported = import(&path);
    assert_eq!((imported.report.untouched, imported.report.channels), (6, 208));
    assert_eq!(
        (imported.layout.channels[0].as_str(), imported.layout.channels[207].as_str()),
        ("d0.r2", "d15.r13")
    );
    assert!(close(f64::from(imported.frames[0].values[0]), 1.016_264_92, 1e-6));
}

#[test]
fn tanks_as_text() {
    let Some(path) = data("eidors_tanks/ds_data_2004/homogeneous/water_1.txt") else { return };
    let frames = read_tank(&path).unwrap();
    assert_eq!((frames.len(), frames[0].readings.len(), frames[0].rim.is_none()), (1, 208, true));
    // Real part of the voltage over the current.
    assert!(close(frames[0].readings[0], 0.030_931 / 0.000_307_14, 1e-9));
    assert_eq!(import(&path).layout.unit, "Ohm");
    let Some(path) = data("pyeidors_tank/2025-06-29-20-00-52_1_10.00_20uA_1000Hz.csv") else { return };
    let frames = read_tank(&path).unwrap();
    assert_eq!(frames.len(), 2);
    assert!(close(frames[0].readings[0], 0.057_816_924_f64.hypot(0.032_587_639), 1e-8));
}

#[test]
fn damaged_recordings_of_tanks_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        read_tank(&path).unwrap_err().to_string().replace(&folder.path().display().to_string(), "DIR")
    };
    insta::assert_snapshot!(refusal("a_1000Hz.csv", "1,2\n1\n"), @"DIR/a_1000Hz.csv, line 2: has 1 numbers, and pairs of real and imaginary part belong there, as many as in line 1");
    insta::assert_snapshot!(refusal("b_1000Hz.csv", "1,2\n3,4\n"), @"DIR/b_1000Hz.csv: has 2 readings, and a frame of 16 electrodes has 208");
    insta::assert_snapshot!(refusal("c.txt", "#MEAS\n#Start\n1 x 3\n"), @r#"DIR/c.txt, line 3: "x" is not a finite number"#);
    insta::assert_snapshot!(refusal("d.txt", "#MEAS\n#Start\n1 2 0\n"), @"DIR/d.txt, line 3: has the current 0, by which nothing can be divided");
}

#[test]
fn tanks_as_matlab_files() {
    let Some(path) = data("eidors_tanks/oct05/ph1t1/avgdata_ph1t1.mat") else { return };
    let frames = read_tank(&path).unwrap();
    assert_eq!(
        frames.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(),
        ["vvRef", "vvAvg1", "vvAvg2", "vvAvg3"]
    );
    // The first reading of a drive is that of the pair behind it: number 2 of 256.
    assert!(frames.iter().all(|frame| frame.readings.len() == 208 && frame.rim.is_none()));
    assert!(
        close(frames[0].readings[0], 0.587_525_52, 1e-8) && close(frames[0].readings[1], 0.157_792_98, 1e-8)
    );
    // No reading of a driven pair, which are 0, is among them.
    assert!(frames.iter().all(|frame| frame.readings.iter().all(|v| *v > 0.0)));
    let imported = import(&path);
    assert_eq!((imported.report.untouched, imported.report.channels), (4, 208));

    // Complex, compressed, and many frames in one variable.
    let Some(path) = data("eidors_tanks/iirc_data_2006.mat") else { return };
    let frames = read_tank(&path).unwrap();
    assert_eq!((frames.len(), frames[0].name.as_str()), (101, "v_reference"));
    assert_eq!((frames[1].name.as_str(), frames[100].name.as_str()), ("v_rotate(1)", "v_rotate(100)"));
    assert!(close(frames[0].readings[0], 4126.93_f64.hypot(88.5523), 1e-2));

    // 32 electrodes with trigonometric patterns are no frame of this kind.
    let Some(path) = data("eidors_tanks/Rensselaer_EIT_Phantom.mat") else { return };
    let refused = read_tank(&path).unwrap_err().to_string();
    assert!(
        refused.ends_with("its variables are `ACT2006_homog` [992, 1], `ACT2000_phant` [992, 1]"),
        "{refused}"
    );
}

#[test]
fn a_matlab_file_of_a_tank_is_read_by_column_and_refused_by_variable() {
    use super::super::mat::tests::{compressed, file, matrix};

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tank.mat");
    let mut values: Vec<f64> = (0..512).map(f64::from).collect();
    let imaginary = vec![0.0; 512];
    fs::write(&path, file(&[compressed(&matrix("v", 2, &values, Some(&imaginary)))])).unwrap();
    let frames = read_tank(&path).unwrap();
    assert_eq!((frames[0].name.as_str(), frames[1].name.as_str()), ("v(1)", "v(2)"));
    // Drive 0 is read at 2 to 14, drive 1 at 3 to 15, drive 2 from 4 on and at 0.
    assert_eq!((frames[0].readings[0], frames[0].readings[12]), (2.0, 14.0));
    assert_eq!((frames[0].readings[13], frames[0].readings[26], frames[0].readings[38]), (19.0, 36.0, 32.0));
    assert_eq!(frames[1].readings[0], 258.0);
    let imported = import(&path);
    assert_eq!((imported.report.untouched, imported.layout.unit.as_str()), (2, "1"));

    let refusal = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        read_tank(&path).unwrap_err().to_string().replace(&folder.path().display().to_string(), "DIR")
    };
    values[256 + 2] = f64::NAN;
    insta::assert_snapshot!(refusal(&file(&[matrix("v", 2, &values, None)])), @"DIR/tank.mat, variable `v`, column 2: has the reading NaN, and finite ones belong there");
    insta::assert_snapshot!(refusal(&file(&[matrix("w", 1, &values[..8], None)])), @"DIR/tank.mat: has no variable with 256 rows, which a frame of 16 electrodes with adjacent drive has; its variables are `w` [8, 1]");
    insta::assert_snapshot!(refusal(b"MATLAB 7.3 MAT-file"), @"DIR/tank.mat: is no little-endian MATLAB file of level 5; save it again with `save -v7`");
}
