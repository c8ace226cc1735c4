//! Type descriptions and their RIHS01 hashes, as the ROS Interface Hashing Standard of REP-2011 defines them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use sha2::{Digest, Sha256};

use crate::parse::{Base, Field, Service, Shape, Structure};

/// One row of a type description.
struct Row {
    name: String,
    type_id: u8,
    capacity: u32,
    string_capacity: u32,
    nested: String,
}

/// Every type of a build by full name, services and their three parts included.
#[derive(Default)]
pub struct Descriptions(BTreeMap<String, Vec<Row>>);

impl Descriptions {
    /// Adds a message or one half of a service.
    pub fn add(&mut self, structure: &Structure) {
        let mut rows: Vec<Row> = structure.fields.iter().map(row).collect();
        if rows.is_empty() {
            // IDL has no empty structures; rosidl fills them.
            rows.push(Row {
                name: "structure_needs_at_least_one_member".to_owned(),
                type_id: 3,
                capacity: 0,
                string_capacity: 0,
                nested: String::new(),
            });
        }
        self.0.insert(structure.name.clone(), rows);
    }

    /// Adds a service: its halves, the event of service introspection, and the service that names all three.
    pub fn add_service(&mut self, service: &Service) {
        self.add(&service.request);
        self.add(&service.response);
        let nested = |name: &str, type_id: u8, capacity: u32, nested: String| Row {
            name: name.to_owned(),
            type_id,
            capacity,
            string_capacity: 0,
            nested,
        };
        let name = &service.name;
        self.0.insert(
            format!("{name}_Event"),
            vec![
                nested("info", 1, 0, "service_msgs/msg/ServiceEventInfo".to_owned()),
                nested("request", 97, 1, format!("{name}_Request")),
                nested("response", 97, 1, format!("{name}_Response")),
            ],
        );
        self.0.insert(
            name.clone(),
            vec![
                nested("request_message", 1, 0, format!("{name}_Request")),
                nested("response_message", 1, 0, format!("{name}_Response")),
                nested("event_message", 1, 0, format!("{name}_Event")),
            ],
        );
    }

    /// Types that `name` refers to, directly or not, in order of name. The error names the type that is missing.
    pub fn references(&self, name: &str) -> Result<BTreeSet<&str>, String> {
        let mut found = BTreeSet::new();
        let mut queue = vec![name];
        while let Some(at) = queue.pop() {
            let rows =
                self.0.get(at).ok_or_else(|| format!("{name} refers to {at}, which is not defined"))?;
            for row in rows.iter().filter(|row| !row.nested.is_empty()) {
                if found.insert(row.nested.as_str()) {
                    queue.push(&row.nested);
                }
            }
        }
        Ok(found)
    }

    /// `RIHS01_` and the SHA-256 of the description's JSON.
    pub fn hash(&self, name: &str) -> Result<String, String> {
        let mut json = String::from("{\"type_description\": ");
        self.individual(&mut json, name);
        json.push_str(", \"referenced_type_descriptions\": [");
        for (i, reference) in self.references(name)?.into_iter().enumerate() {
            if i > 0 {
                json.push_str(", ");
            }
            self.individual(&mut json, reference);
        }
        json.push_str("]}");
        let mut hash = String::from("RIHS01_");
        for byte in Sha256::digest(json.as_bytes()) {
            write!(hash, "{byte:02x}").expect("writing to a String cannot fail");
        }
        Ok(hash)
    }

    fn individual(&self, out: &mut String, name: &str) {
        let rows = self.0.get(name).map_or(&[][..], Vec::as_slice);
        let rows: Vec<String> = rows
            .iter()
            .map(|row| {
                format!(
                    "{{\"name\": \"{}\", \"type\": {{\"type_id\": {}, \"capacity\": {}, \"string_capacity\": {}, \
                     \"nested_type_name\": \"{}\"}}}}",
                    row.name, row.type_id, row.capacity, row.string_capacity, row.nested
                )
            })
            .collect();
        write!(out, "{{\"type_name\": \"{name}\", \"fields\": [{}]}}", rows.join(", "))
            .expect("writing to a String cannot fail");
    }
}

fn row(field: &Field) -> Row {
    let base = match field.base {
        Base::Nested(_) => 1,
        Base::Int8 => 2,
        Base::Uint8 => 3,
        Base::Int16 => 4,
        Base::Uint16 => 5,
        Base::Int32 => 6,
        Base::Uint32 => 7,
        Base::Int64 => 8,
        Base::Uint64 => 9,
        Base::Float32 => 10,
        Base::Float64 => 11,
        Base::Bool => 15,
        Base::Byte => 16,
        Base::String(None) => 17,
        Base::String(Some(_)) => 21,
    };
    let (offset, capacity) = match field.shape {
        Shape::One => (0, 0),
        Shape::Array(n) => (48, n),
        Shape::Bounded(n) => (96, n),
        Shape::Sequence => (144, 0),
    };
    Row {
        name: field.name.clone(),
        type_id: base + offset,
        capacity,
        string_capacity: if let Base::String(Some(bound)) = field.base { bound } else { 0 },
        nested: if let Base::Nested(name) = &field.base { name.clone() } else { String::new() },
    }
}
