//! Data sets as tables, for people who train elsewhere: Parquet and NPZ, one row a frame.
//!
//! | column (Parquet) | array (NPZ) | unit | what it is |
//! |---|---|---|---|
//! | `stamp` | `stamp` \[n\] | ns | when the frame was acquired, since 1970 |
//! | `sequence` | `sequence` \[n\] | 1 | counts every frame of the device; a step > 1 is a loss |
//! | `channel.NAME` | `values` \[n, channels\] | the skin's | readings as the device gave them, NaN where invalid |
//! | `tared.NAME` | `tared` \[n, channels\] | the skin's | readings minus their zero; only where requested |
//! | `flags.NAME` | `flags` \[n, channels\] | bits | `dermis_msgs/TaxelFrame` FLAG_*; 0 is healthy |
//! | `temperature` | `temperature` \[n\] | K | of the skin, NaN where unknown |
//! | `contacts` | `contacts` \[n\] | 1 | true contacts, −1 without ground truth |
//! | `idle` | `idle` \[n\] | 0, 1 | 1 where it is known that nothing is near |
//! | `press`, `location` | the same | 1 | identity of press and place, −1 without ground truth |
//! | `position.x` …, `normal.x` … | `position`, `normal` \[n, 3\] | m, 1 | of the only contact, in the skin's link; NaN otherwise |
//! | `force.x` … | `force` \[n, 3\] | N | exerted on the skin, 0 where it is untouched, NaN where unknown |
//! | `force_normal` | the same | N | pressing force, positive |
//! | `split` | `split` \[n\] | | `train`, `held_out`, or empty without ground truth |
//!
//! Where the bags hold more frames than [`DatasetOptions::most_frames`](crate::DatasetOptions::most_frames), rows are those that are in the
//! index of the data set; `frames` in the file says how many there are, and `every` of how many one is there.
//!
//! The same in JSON is in the file: key `dermis` of the Parquet metadata, `schema.json` in the NPZ.

mod columns;

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use npyz::WriterBuilder;
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::Type;
use serde_json::json;

use crate::dataset::{Dataset, Run, Sample, SampleId};
use crate::{LearnError, SplitConfig};

/// Rows that are encoded together; what is held in memory beside the data set is one column of them.
const ROW_GROUP: usize = 16_384;

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// Apache Parquet, compressed with zstd.
    Parquet,
    /// NumPy's archive of arrays, compressed.
    Npz,
}

impl Format {
    /// As it is written in flags and as the end of file names.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Parquet => "parquet",
            Self::Npz => "npz",
        }
    }
}

impl std::str::FromStr for Format {
    type Err = LearnError;

    fn from_str(text: &str) -> Result<Self, LearnError> {
        [Self::Parquet, Self::Npz].into_iter().find(|f| f.name() == text).ok_or_else(|| LearnError::Config {
            file: "flags".into(),
            field: "--format".into(),
            reason: format!("is `{text}` and must be `parquet` or `npz`"),
        })
    }
}

/// How tables are written.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportOptions {
    /// Which files.
    pub formats: Vec<Format>,
    /// Adds readings minus their zero.
    pub tared: bool,
    /// Which rows are held out.
    pub split: SplitConfig,
}

/// Writes every run of a data set, called as its bag; the files that were written. Bags of different folders may have one name:
/// the later one gets its number in the data set behind it.
///
/// # Errors
///
/// [`LearnError`] names the file that cannot be written.
pub fn export_all(data: &Dataset, dir: &Path, options: &ExportOptions) -> Result<Vec<PathBuf>, LearnError> {
    let (mut names, mut files) = (BTreeSet::new(), Vec::new());
    for (i, run) in data.runs().iter().enumerate() {
        let name = run.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let name = if names.insert(name.clone()) { name } else { format!("{name}-{}", i + 1) };
        files.extend(export(data, i, dir, &name, options)?);
    }
    Ok(files)
}

/// Writes the run of a data set with this index as `DIR/STEM.parquet` and `DIR/STEM.npz`; the files that were written.
///
/// # Errors
///
/// [`LearnError`] names the file that cannot be written.
pub fn export(
    data: &Dataset,
    run: usize,
    dir: &Path,
    stem: &str,
    options: &ExportOptions,
) -> Result<Vec<PathBuf>, LearnError> {
    let Some(recorded) = data.runs().get(run) else { return Ok(Vec::new()) };
    std::fs::create_dir_all(dir).map_err(LearnError::io(dir, "written"))?;
    let table = Table::new(data, run, recorded, options);
    let mut written = Vec::new();
    for format in &options.formats {
        let path = dir.join(format!("{stem}.{}", format.name()));
        // A file that is cut short must not be taken for a whole one.
        let partial = dir.join(format!("{stem}.{}.partial", format.name()));
        match format {
            Format::Parquet => table.parquet(&partial)?,
            Format::Npz => table.npz(&partial)?,
        }
        std::fs::rename(&partial, &path).map_err(LearnError::io(&path, "written"))?;
        written.push(path);
    }
    Ok(written)
}

/// One column or array: how it is called, what it is in, what it says.
struct Column {
    name: &'static str,
    unit: String,
    meaning: &'static str,
    /// Names of the parts of an array with several columns.
    parts: Vec<String>,
    values: Values,
}

type Get<T> = Box<dyn Fn(&Sample, usize) -> T>;

enum Values {
    Whole(Get<i64>),
    Byte(Get<u8>),
    Single(Get<f32>),
    Double(Get<f64>),
    /// Name of the part of the split.
    Text(fn(Option<bool>) -> &'static str),
}

struct Table<'a> {
    data: &'a Dataset,
    index: usize,
    frames: usize,
    /// Whether each sample is held out; `None` without ground truth.
    held_out: Vec<Option<bool>>,
    columns: Vec<Column>,
    schema: String,
}

impl<'a> Table<'a> {
    fn new(data: &'a Dataset, index: usize, run: &Run, options: &ExportOptions) -> Self {
        let columns = columns::columns(data.skin(), options.tared);
        let described: Vec<_> = columns
            .iter()
            .map(|c| json!({ "name": c.name, "parts": c.parts, "unit": c.unit, "meaning": c.meaning }))
            .collect();
        let skin = data.skin();
        let schema = json!({
            "schema": "dermis-table/1",
            "skin": { "name": skin.name, "hash": skin.hash(), "unit": skin.unit, "frame_id": skin.frame_id,
                      "rate_hz": skin.rate },
            "bag": run.path.file_name().map(|n| n.to_string_lossy()),
            "session": run.session,
            "hash": run.hash,
            "lost": run.lost,
            "frames": run.frames(),
            "every": run.every(),
            "split": options.split,
            "split_in_words": options.split.describe(),
            "map": data.map(),
            "columns": described,
        });
        Self {
            data,
            index,
            frames: run.samples.len(),
            held_out: options.split.mark(run),
            columns,
            schema: schema.to_string(),
        }
    }

    /// The frames that are in the index of the data set.
    fn rows(&self) -> Result<impl Iterator<Item = Result<Sample, LearnError>> + '_, LearnError> {
        let all = self.data.stream(self.index)?.enumerate();
        let indexed = |sample| self.data.sample(SampleId { run: self.index, sample }).is_some();
        Ok(all.filter(move |(number, s)| s.is_err() || indexed(*number)).map(|(_, s)| s))
    }

    fn parquet(&self, path: &Path) -> Result<(), LearnError> {
        let failed = |e: parquet::errors::ParquetError| LearnError::Export {
            path: path.to_owned(),
            reason: e.to_string(),
        };
        let mut fields = Vec::new();
        for column in &self.columns {
            let physical = match column.values {
                Values::Whole(_) => Physical::INT64,
                Values::Byte(_) => Physical::INT32,
                Values::Single(_) => Physical::FLOAT,
                Values::Double(_) => Physical::DOUBLE,
                Values::Text(_) => Physical::BYTE_ARRAY,
            };
            let names = column.parts.iter().map(|part| format!("{}.{part}", parquet_name(column.name)));
            let names: Vec<String> =
                if column.parts.is_empty() { vec![column.name.to_owned()] } else { names.collect() };
            for name in names {
                let text = matches!(column.values, Values::Text(_)).then_some(LogicalType::String);
                let field = Type::primitive_type_builder(&name, physical)
                    .with_repetition(Repetition::REQUIRED)
                    .with_logical_type(text);
                fields.push(Arc::new(field.build().map_err(failed)?));
            }
        }
        let schema = Type::group_type_builder("frames").with_fields(fields).build().map_err(failed)?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_key_value_metadata(Some(vec![KeyValue::new("dermis".to_owned(), self.schema.clone())]))
            .build();
        let file = File::create(path).map_err(LearnError::io(path, "written"))?;
        let mut writer =
            SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties)).map_err(failed)?;
        let mut frames = self.rows()?;
        for held_out in self.held_out.chunks(ROW_GROUP) {
            let samples: Vec<Sample> = frames.by_ref().take(held_out.len()).collect::<Result<_, _>>()?;
            let mut rows = writer.next_row_group().map_err(failed)?;
            for column in &self.columns {
                for part in 0..column.parts.len().max(1) {
                    let Some(mut out) = rows.next_column().map_err(failed)? else { continue };
                    column.fill(&samples, held_out, part, out.untyped()).map_err(failed)?;
                    out.close().map_err(failed)?;
                }
            }
            rows.close().map_err(failed)?;
        }
        let file = writer.into_inner().map_err(failed)?;
        file.sync_all().map_err(LearnError::io(path, "written"))
    }

    fn npz(&self, path: &Path) -> Result<(), LearnError> {
        let io = |e: std::io::Error| LearnError::io(path, "written")(e);
        let failed =
            |e: zip::result::ZipError| LearnError::Export { path: path.to_owned(), reason: e.to_string() };
        let file = File::create(path).map_err(io)?;
        let mut archive = zip::ZipWriter::new(BufWriter::new(file));
        let entry = zip::write::SimpleFileOptions::default().large_file(true);
        archive.start_file("schema.json", entry).map_err(failed)?;
        archive.write_all(self.schema.as_bytes()).map_err(io)?;
        for column in &self.columns {
            archive.start_file(format!("{}.npy", column.name), entry).map_err(failed)?;
            self.array(column, &mut archive, path)?;
        }
        let file = archive.finish().map_err(failed)?.into_inner().map_err(|e| io(e.into_error()))?;
        file.sync_all().map_err(io)
    }

    /// One pass over the frames for each array: NPZ holds them one behind the other.
    fn array(&self, column: &Column, out: &mut impl Write, path: &Path) -> Result<(), LearnError> {
        let io = |e: std::io::Error| LearnError::io(path, "written")(e);
        let rows = self.frames as u64;
        let parts = column.parts.len();
        let shape = if parts == 0 { vec![rows] } else { vec![rows, parts as u64] };
        macro_rules! write {
            ($kind:ty, $get:expr) => {{
                let options = npyz::WriteOptions::<$kind>::new().default_dtype().shape(&shape);
                let mut writer = options.writer(out).begin_nd().map_err(io)?;
                for sample in self.rows()? {
                    let sample = sample?;
                    writer.extend((0..parts.max(1)).map(|part| $get(&sample, part))).map_err(io)?;
                }
                writer.finish().map_err(io)
            }};
        }
        match &column.values {
            Values::Whole(get) => write!(i64, get),
            Values::Byte(get) => write!(u8, get),
            Values::Single(get) => write!(f32, get),
            Values::Double(get) => write!(f64, get),
            Values::Text(name) => {
                let wide = npyz::DType::Plain("|S8".parse().map_err(std::io::Error::other).map_err(io)?);
                let options = npyz::WriteOptions::<[u8]>::new().dtype(wide).shape(&shape);
                let mut writer = options.writer(out).begin_nd().map_err(io)?;
                let mut names = self.held_out.iter().map(|held_out| name(*held_out).as_bytes());
                names.try_for_each(|name| writer.push(name)).map_err(io)?;
                writer.finish().map_err(io)
            }
        }
    }
}

/// What the columns of an array are called in a flat table.
fn parquet_name(name: &str) -> &str {
    if name == "values" { "channel" } else { name }
}

impl Column {
    fn fill(
        &self,
        samples: &[Sample],
        held_out: &[Option<bool>],
        part: usize,
        out: &mut ColumnWriter<'_>,
    ) -> Result<(), parquet::errors::ParquetError> {
        match (&self.values, out) {
            (Values::Whole(get), ColumnWriter::Int64ColumnWriter(out)) => {
                let values: Vec<i64> = samples.iter().map(|s| get(s, part)).collect();
                out.write_batch(&values, None, None)?;
            }
            (Values::Byte(get), ColumnWriter::Int32ColumnWriter(out)) => {
                let values: Vec<i32> = samples.iter().map(|s| i32::from(get(s, part))).collect();
                out.write_batch(&values, None, None)?;
            }
            (Values::Single(get), ColumnWriter::FloatColumnWriter(out)) => {
                let values: Vec<f32> = samples.iter().map(|s| get(s, part)).collect();
                out.write_batch(&values, None, None)?;
            }
            (Values::Double(get), ColumnWriter::DoubleColumnWriter(out)) => {
                let values: Vec<f64> = samples.iter().map(|s| get(s, part)).collect();
                out.write_batch(&values, None, None)?;
            }
            (Values::Text(name), ColumnWriter::ByteArrayColumnWriter(out)) => {
                let values: Vec<ByteArray> = held_out.iter().map(|h| ByteArray::from(name(*h))).collect();
                out.write_batch(&values, None, None)?;
            }
            _ => {
                return Err(parquet::errors::ParquetError::General(format!(
                    "column {} has another type than its schema",
                    self.name
                )));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
