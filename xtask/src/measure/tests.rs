use super::*;

#[test]
fn work_at_once_keeps_its_order_and_its_first_error() {
    let items: Vec<u32> = (0..20).collect();
    for jobs in [0, 1, 3, 50] {
        assert_eq!(at_once(jobs, &items, |n| Ok(n * n)).unwrap()[7], 49);
        let refused = at_once(jobs, &items, |n| if *n == 5 { bail!("five") } else { Ok(*n) });
        assert_eq!(refused.unwrap_err().to_string(), "five");
    }
    assert!(at_once(2, &[], |_: &u32| Ok(())).unwrap().is_empty());
}

#[test]
fn what_is_printed_is_read_in_one_line_and_in_many() {
    assert_eq!(printed("{\n  \"a\": [\n    1\n  ]\n}\n").unwrap(), json!({ "a": [1] }));
    assert_eq!(printed("3 frames\n{\"a\":1}\n").unwrap(), json!({ "a": 1 }));
    assert!(printed("3 frames\n").is_err());
}
