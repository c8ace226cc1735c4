//! Decoding allocates a small multiple of its input, whatever lengths the input claims.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use dermis_msgs::geometry_msgs::msg::WrenchStamped;
use dermis_msgs::msg::{
    BodyContacts, ContactArray, DisplacementMap, ForceMap, Indentation, SkinGeometry, TaxelFrame,
};
use dermis_msgs::rcl_interfaces::msg::{ParameterEvent, ParameterValue};
use dermis_msgs::rcl_interfaces::srv::{DescribeParametersResponse, SetParametersRequest};
use dermis_msgs::sensor_msgs::msg::PointCloud2;
use dermis_msgs::visualization_msgs::msg::MarkerArray;
use dermis_msgs::{Message, std_msgs, v0};
use proptest::collection::vec;
use proptest::prelude::*;

thread_local! {
    /// Bytes that this thread requested, not counting what it gave back.
    static ALLOCATED: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATED.with(|allocated| allocated.set(allocated.get() + layout.size()));
        // SAFETY: the caller's promises are those of `GlobalAlloc::alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: `ptr` came from `alloc` above with this layout.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Bytes requested, for each byte of input: an empty string is 24 bytes here and 4 on the wire.
const MULTIPLE: usize = 12;

fn decode<T: Message>(bytes: &[u8]) {
    let before = ALLOCATED.get();
    let result = T::from_cdr(bytes);
    let allocated = ALLOCATED.get() - before;
    drop(result);
    assert!(
        allocated <= MULTIPLE * bytes.len(),
        "{}: {allocated} bytes for {} of input",
        T::TYPE_NAME,
        bytes.len()
    );
}

fn decode_as_everything(bytes: &[u8]) {
    decode::<BodyContacts>(bytes);
    decode::<ContactArray>(bytes);
    decode::<DescribeParametersResponse>(bytes);
    decode::<DisplacementMap>(bytes);
    decode::<ForceMap>(bytes);
    decode::<Indentation>(bytes);
    decode::<MarkerArray>(bytes);
    decode::<ParameterEvent>(bytes);
    decode::<ParameterValue>(bytes);
    decode::<PointCloud2>(bytes);
    decode::<SetParametersRequest>(bytes);
    decode::<SkinGeometry>(bytes);
    decode::<TaxelFrame>(bytes);
    decode::<WrenchStamped>(bytes);
    decode::<std_msgs::msg::String>(bytes);
    decode::<v0::msg::Indentation>(bytes);
    decode::<v0::msg::SkinGeometry>(bytes);
    decode::<v0::msg::TaxelFrame>(bytes);
}

/// Lengths as an attacker would choose them: small ones lead deep into a message, large ones ask for memory.
fn words() -> impl Strategy<Value = u32> {
    prop_oneof![4 => 0u32..4, 2 => 4u32..2000, 1 => Just(u32::MAX), 1 => Just(i32::MAX as u32), 1 => any::<u32>()]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn memory_stays_within_a_multiple_of_the_input(words in vec(words(), 0..600), little_endian: bool) {
        let mut bytes = vec![0, u8::from(little_endian), 0, 0];
        for word in words {
            bytes.extend(if little_endian { word.to_le_bytes() } else { word.to_be_bytes() });
        }
        decode_as_everything(&bytes);
    }
}

/// As many elements as the input can just hold, and then an error in the last one.
#[test]
fn the_longest_sequences_stay_within_a_multiple_of_the_input() {
    for count in 1..3000u32 {
        let mut bytes = vec![0, 1, 0, 0];
        bytes.extend(count.to_le_bytes());
        bytes.resize(12_000, 0);
        decode::<DescribeParametersResponse>(&bytes);
        decode::<SetParametersRequest>(&bytes);
        decode::<MarkerArray>(&bytes);
    }
}
