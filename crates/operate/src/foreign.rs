//! Message types that the program was not built with: known by name, hash and definition, their bytes pass as they are.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use dermis_msgs::{CdrError, CdrErrorKind, TypeSupport};

use crate::error::NoDefinition;

/// The definition of a type from the ROS 2 that is sourced.
pub fn definition(type_name: &str) -> Result<String, NoDefinition> {
    dermis_bag::definition_of(type_name).map_err(NoDefinition)
}

/// The support of such a type, made once for each type, hash and definition and kept until the program ends.
pub fn support(type_name: &str, hash: &str, definition: &str) -> &'static TypeSupport {
    static KNOWN: Mutex<BTreeMap<[String; 3], &'static TypeSupport>> = Mutex::new(BTreeMap::new());
    let key = [type_name, hash, definition].map(str::to_owned);
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    known.entry(key).or_insert_with_key(|[name, hash, definition]| {
        Box::leak(Box::new(TypeSupport {
            name: name.clone().leak(),
            hash: hash.clone().leak(),
            definition: definition.clone().leak(),
            cdr_to_json: |_| Err(opaque()),
            json_to_cdr: |_| Err(opaque()),
        }))
    })
}

fn opaque() -> CdrError {
    let problem = "this type is not built in, only its bytes are known".to_owned();
    CdrError { type_name: "a foreign type", kind: CdrErrorKind::Json { path: ".".to_owned(), problem } }
}
