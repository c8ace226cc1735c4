//! Things by the group that they belong to, one group behind the other (counting sort; H. H. Seward, 1954).

/// Where the things of each group begin, and where those of the last one end; `of` are the groups of all things.
pub(super) fn starts(groups: usize, of: impl Iterator<Item = usize>) -> Vec<u32> {
    let mut starts = vec![0_u32; groups + 1];
    of.for_each(|group| starts[group + 1] += 1);
    for group in 0..groups {
        starts[group + 1] += starts[group];
    }
    starts
}

/// The same, and the things: in the order in which they are, group by group.
pub(super) fn grouped(groups: usize, of: impl Iterator<Item = usize> + Clone) -> (Vec<u32>, Vec<u32>) {
    let starts = starts(groups, of.clone());
    let mut next = starts.clone();
    let mut things = vec![0; starts[groups] as usize];
    for (thing, group) in of.enumerate() {
        things[next[group] as usize] = thing as u32;
        next[group] += 1;
    }
    (starts, things)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn things_stand_behind_each_other_by_their_groups() {
        let (starts, things) = grouped(4, [2, 0, 2, 3, 0].into_iter());
        assert_eq!((starts, things), (vec![0, 2, 2, 4, 5], vec![1, 4, 0, 2, 3]));
    }
}
