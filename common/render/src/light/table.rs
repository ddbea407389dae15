//! From a triangle of the scene to its place among the emitters and back.

/// A run of neighbouring primitives of one instance that all emit.
#[derive(Clone, Copy, Debug)]
struct Run {
    instance: u32,
    first_primitive: u32,
    first_emitter: u32,
    two_sided: bool,
}

/// Emissive triangles, numbered in the order of (instance, primitive). A mesh that emits everywhere costs one entry.
#[derive(Debug, Default)]
pub(super) struct TriangleTable {
    runs: Vec<Run>,
    count: u32,
}

/// A triangle as it stands in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TriangleEntry {
    pub emitter: u32,
    pub instance: u32,
    pub primitive: u32,
    pub two_sided: bool,
}

impl TriangleTable {
    /// Appends a triangle that comes after all others.
    pub fn push(&mut self, instance: u32, primitive: u32, two_sided: bool) -> u32 {
        let emitter = self.count;
        let continues = self.runs.last().is_some_and(|run| {
            let next = run.first_primitive + (emitter - run.first_emitter);
            run.instance == instance && run.two_sided == two_sided && next == primitive
        });
        if !continues {
            let run = Run { instance, first_primitive: primitive, first_emitter: emitter, two_sided };
            self.runs.push(run);
        }
        self.count += 1;
        emitter
    }

    /// How many there are.
    pub fn len(&self) -> u32 {
        self.count
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(self.runs.as_slice())
    }

    /// The triangle with this number.
    pub fn get(&self, emitter: u32) -> TriangleEntry {
        let run = self.runs[self.runs.partition_point(|run| run.first_emitter <= emitter) - 1];
        let primitive = run.first_primitive + (emitter - run.first_emitter);
        TriangleEntry { emitter, instance: run.instance, primitive, two_sided: run.two_sided }
    }

    /// The triangle of the scene, if it emits.
    pub fn find(&self, instance: u32, primitive: u32) -> Option<TriangleEntry> {
        let after =
            self.runs.partition_point(|run| (run.instance, run.first_primitive) <= (instance, primitive));
        let index = after.checked_sub(1)?;
        let run = self.runs[index];
        if run.instance != instance {
            return None;
        }
        let end = self.runs.get(after).map_or(self.count, |next| next.first_emitter);
        let emitter = run.first_emitter.checked_add(primitive - run.first_primitive)?;
        (emitter < end).then_some(TriangleEntry { emitter, instance, primitive, two_sided: run.two_sided })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_are_found_from_both_sides_across_gaps() {
        let mut table = TriangleTable::default();
        let all = [(2, 5, false), (2, 6, false), (2, 9, false), (2, 10, true), (7, 0, true), (7, 1, true)];
        for (instance, primitive, two_sided) in all {
            table.push(instance, primitive, two_sided);
        }
        assert_eq!((table.len(), table.runs.len()), (6, 4));
        for (emitter, (instance, primitive, two_sided)) in all.into_iter().enumerate() {
            let entry = TriangleEntry { emitter: emitter as u32, instance, primitive, two_sided };
            assert_eq!(table.get(emitter as u32), entry);
            assert_eq!(table.find(instance, primitive), Some(entry));
        }
        for (instance, primitive) in [(0, 0), (2, 4), (2, 7), (2, 8), (2, 11), (3, 0), (7, 2), (8, 0)] {
            assert_eq!(table.find(instance, primitive), None, "({instance}, {primitive}) does not emit");
        }
        assert_eq!(TriangleTable::default().find(0, 0), None);
    }
}
