use super::*;
use std::sync::Mutex;

/// The folder is one for the whole process.
static ALONE: Mutex<()> = Mutex::new(());

fn key(number: u32) -> Key {
    Key::new("test").debug(&number)
}

type Numbers = (Vec<f64>, Vec<i16>);

#[derive(Debug, PartialEq)]
struct Field(Numbers);

impl Keep for Field {
    fn put(&self, out: &mut Vec<u8>) {
        self.0.0.put(out);
        self.0.1.put(out);
    }

    fn take(from: &mut Bytes<'_>) -> Option<Self> {
        Some(Self((Keep::take(from)?, Keep::take(from)?)))
    }
}

fn field() -> Field {
    Field((vec![1.5, -0.0, f64::MIN_POSITIVE, 1e300], vec![-3, 7]))
}

/// Asks for a field; whether it was computed.
fn ask(number: u32) -> (Field, bool) {
    let mut computed = false;
    let found = kept::<Field, ()>("a field", key(number), || {
        computed = true;
        Ok(field())
    });
    (found.unwrap(), computed)
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    all.sort();
    all
}

#[test]
fn what_was_computed_once_is_found_again_by_its_key_only() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("of/dermis");
    assert!(ask(1).1 && ask(1).1, "nothing is kept unless requested");
    use_folder(Some(cache.clone()));
    assert_eq!((ask(1), ask(1), ask(2)), ((field(), true), (field(), false), (field(), true)));
    assert_eq!(entries(&cache).len(), 2);
    assert!(!noted(key(3)));
    note("a check", key(3));
    assert!(noted(key(3)) && !noted(key(4)));
    assert!(kept::<Field, &str>("a field", key(5), || Err("no")).is_err());
    assert_eq!(entries(&cache).len(), 3, "a failure is not kept");
    use_folder(None);
    assert!(ask(1).1);
}

#[test]
fn damaged_entries_are_ignored_and_replaced() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    use_folder(Some(folder.path().to_owned()));
    ask(1);
    let [path] = entries(folder.path()).try_into().unwrap();
    let whole = std::fs::read(&path).unwrap();
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x10;
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(ask(1), (field(), true), "byte {at}");
        std::fs::write(&path, &whole[..at]).unwrap();
        assert_eq!(ask(1), (field(), true), "cut at {at}");
    }
    assert_eq!(ask(1), (field(), false), "it was replaced");
    // An entry under another one's name.
    ask(2);
    let other = entries(folder.path()).into_iter().find(|p| *p != path).unwrap();
    std::fs::copy(&path, &other).unwrap();
    assert!(ask(2).1);
    // Longer than any entry, without the bytes on the disk; and no file at all.
    File::options().write(true).open(&path).unwrap().set_len(8 << 30).unwrap();
    assert!(ask(1).1 && !ask(1).1);
    std::fs::remove_file(&path).unwrap();
    std::fs::create_dir(&path).unwrap();
    assert!(ask(1).1 && ask(1).1, "what cannot be replaced is computed each time");
    use_folder(None);
}

#[test]
fn the_oldest_go_first() {
    let folder = tempfile::tempdir().unwrap();
    let now = SystemTime::now();
    for (name, age) in [("a", 30), ("b", 10), ("c", 20)] {
        let file = File::create(folder.path().join(name).with_extension(EXTENSION)).unwrap();
        file.set_len(100).unwrap();
        file.set_modified(now - Duration::from_secs(age)).unwrap();
    }
    let left = File::create(folder.path().join(".77-0")).unwrap();
    left.set_modified(now - Duration::from_secs(7200)).unwrap();
    std::fs::write(folder.path().join("notes.txt"), "of somebody else").unwrap();
    tidy(folder.path(), 200);
    let names: Vec<_> = entries(folder.path()).iter().map(|p| p.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, ["b.kept", "c.kept", "notes.txt"]);
}
