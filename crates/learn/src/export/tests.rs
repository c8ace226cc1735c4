use std::io::Read;

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;

use super::*;
use crate::dataset::tests::{presses, samples};

fn array<T: npyz::Deserialize>(path: &Path, name: &str) -> (Vec<u64>, Vec<T>) {
    let mut archive = zip::ZipArchive::new(File::open(path).unwrap()).unwrap();
    let npy = npyz::NpyFile::new(archive.by_name(&format!("{name}.npy")).unwrap()).unwrap();
    (npy.shape().to_vec(), npy.into_vec().unwrap())
}

#[test]
fn both_formats_hold_every_frame() {
    let dir = tempfile::tempdir().unwrap();
    let mut data = presses(60, 25);
    let mut runs = data.runs().to_vec();
    runs[0].samples[5].truth = None;
    data = Dataset::from_runs(data.skin(), runs);
    let options = ExportOptions {
        formats: vec![Format::Parquet, Format::Npz],
        tared: true,
        split: SplitConfig::default(),
    };
    let files = export(&data, 0, dir.path(), "made", &options).unwrap();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
    let samples = samples(&data);
    assert!(samples.len() > ROW_GROUP, "more than one row group");

    let table = SerializedFileReader::new(File::open(&files[0]).unwrap()).unwrap();
    let meta = table.metadata().file_metadata();
    assert_eq!((meta.num_rows() as usize, table.num_row_groups()), (samples.len(), 2));
    let schema: serde_json::Value =
        serde_json::from_str(meta.key_value_metadata().unwrap()[0].value.as_ref().unwrap()).unwrap();
    assert_eq!(
        (schema["skin"]["unit"].as_str(), schema["hash"].as_str()),
        (Some("Pa"), Some(&*data.runs()[0].hash))
    );
    let (shape, values) = array::<f32>(&files[1], "values");
    assert_eq!(shape, [samples.len() as u64, 2]);
    let (_, forces) = array::<f64>(&files[1], "force_normal");
    let (_, splits) = array::<Vec<u8>>(&files[1], "split");
    for (i, row) in table.get_row_iter(None).unwrap().enumerate() {
        let row = row.unwrap();
        let field =
            |name: &str| row.get_column_iter().find(|(n, _)| *n == name).map(|(_, f)| f.clone()).unwrap();
        let truth = samples[i].truth.as_ref();
        assert_eq!(field("stamp"), Field::Long(samples[i].frame.stamp));
        assert_eq!(field("channel.right"), Field::Float(samples[i].frame.values[1]));
        assert_eq!(values[2 * i + 1], samples[i].frame.values[1]);
        assert_eq!(field("contacts"), Field::Long(truth.map_or(-1, |t| t.contacts.len() as i64)));
        let known = truth.and_then(|t| t.value("force.normal"));
        assert!(known.map_or(forces[i].is_nan(), |f| f == forces[i]));
        let Field::Str(split) = field("split") else { panic!("split is no text") };
        assert_eq!(split.as_bytes(), splits[i]);
        assert_eq!(split.is_empty(), truth.is_none());
    }
    let mut text = String::new();
    let mut archive = zip::ZipArchive::new(File::open(&files[1]).unwrap()).unwrap();
    archive.by_name("schema.json").unwrap().read_to_string(&mut text).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), schema);

    let held_out = options.split.apply(&data).unwrap().test;
    assert_eq!(splits.iter().filter(|s| *s == b"held_out").count(), held_out.len());
}
