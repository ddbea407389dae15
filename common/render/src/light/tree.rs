//! A binary tree over many lights that finds one in proportion to its estimated effect at a point.
//!
//! After Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting": one descent, one uniform
//! number, at each node a choice between two children by the bounds of what they hold.

use super::{
    bounds::{Item, LightBounds, unite},
    geometry::View,
};
use glam::DVec3;

/// Slots into which centres are sorted to find a split.
const BUCKETS: usize = 12;

/// Bits of a trail: no leaf may lie deeper.
const DEPTH_MAX: u32 = 64;

/// Marks a leaf.
const LEAF: u32 = 1 << 31;

/// A group of lights and its two halves, or one light.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: LightBounds,
    /// Index of the first of two neighbouring children; for a leaf [`LEAF`] and the light.
    link: u32,
}

/// The tree.
#[derive(Debug)]
pub(super) struct LightTree {
    nodes: Vec<Node>,
    /// For each light the turns from the root to its leaf: bit d is set where the second child is taken at depth d.
    trails: Vec<u64>,
}

/// Part of the lights that still has to become a node.
struct Job {
    start: usize,
    end: usize,
    node: usize,
    depth: u32,
    trail: u64,
}

impl LightTree {
    /// Builds over at least one light whose emitter indices are 0, 1, 2, ... in any order. Deterministic.
    pub fn build(mut items: Vec<Item>, unit: f64) -> Self {
        assert!(items.len() < LEAF as usize / 2, "indices of nodes fit into 31 bits");
        let empty = Node { bounds: items[0].bounds, link: LEAF };
        let mut nodes = Vec::with_capacity(2 * items.len() - 1);
        let mut trails = vec![0; items.len()];
        nodes.push(empty);
        let mut jobs = vec![Job { start: 0, end: items.len(), node: 0, depth: 0, trail: 0 }];
        while let Some(Job { start, end, node, depth, trail }) = jobs.pop() {
            let group = &mut items[start..end];
            nodes[node].bounds = unite(group, unit);
            if let [item] = group {
                nodes[node].link = LEAF | item.emitter;
                trails[item.emitter as usize] = trail;
                continue;
            }
            let middle = start + split(group, depth);
            let first = nodes.len();
            nodes[node].link = first as u32;
            nodes.extend([empty; 2]);
            let depth_below = depth + 1;
            jobs.push(Job {
                start: middle,
                end,
                node: first + 1,
                depth: depth_below,
                trail: trail | 1 << depth,
            });
            jobs.push(Job { start, end: middle, node: first, depth: depth_below, trail });
        }
        Self { nodes, trails }
    }

    /// Nodes, for reports.
    pub fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.trails.as_slice())
    }

    /// Importance of all lights together.
    pub fn importance(&self, view: &View) -> f64 {
        self.nodes[0].bounds.importance(view)
    }

    fn children(&self, node: &Node, view: &View) -> Option<([&Node; 2], f64)> {
        let first = node.link as usize;
        let pair = [&self.nodes[first], &self.nodes[first + 1]];
        let [a, b] = pair.map(|child| child.bounds.importance(view));
        let sum = a + b;
        // Where the group's bounds promised more than those of its halves, nothing arrives.
        (sum > 0.0).then(|| (pair, a / sum))
    }

    /// A light and the probability of choosing it; none where no light can arrive.
    pub fn sample(&self, view: &View, mut u: f64) -> Option<(u32, f64)> {
        let mut node = &self.nodes[0];
        let mut probability = 1.0;
        while node.link & LEAF == 0 {
            let ([first, second], share) = self.children(node, view)?;
            if u < share {
                node = first;
                u /= share;
                probability *= share;
            } else {
                node = second;
                u = (u - share) / (1.0 - share);
                probability *= 1.0 - share;
            }
        }
        Some((node.link & !LEAF, probability))
    }

    /// The probability with which [`LightTree::sample`] chooses a light.
    pub fn probability(&self, view: &View, emitter: u32) -> f64 {
        let mut trail = self.trails[emitter as usize];
        let mut node = &self.nodes[0];
        let mut probability = 1.0;
        while node.link & LEAF == 0 {
            let Some(([first, second], share)) = self.children(node, view) else { return 0.0 };
            (node, probability) = if trail & 1 == 0 {
                (first, probability * share)
            } else {
                (second, probability * (1.0 - share))
            };
            trail >>= 1;
        }
        probability
    }
}

#[derive(Clone, Copy)]
struct Bucket {
    count: usize,
    power: f64,
    axis: DVec3,
    min: DVec3,
    max: DVec3,
}

impl Bucket {
    const EMPTY: Self =
        Self { count: 0, power: 0.0, axis: DVec3::ZERO, min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    fn add(&mut self, item: &Item) {
        self.count += 1;
        self.power += item.power;
        self.axis += item.weighted_axis();
        self.min = self.min.min(item.bounds.min.as_dvec3());
        self.max = self.max.max(item.bounds.max.as_dvec3());
    }

    fn join(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            power: self.power + other.power,
            axis: self.axis + other.axis,
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Power times extent times spread of directions: what makes the group's bounds say little.
    ///
    /// The orientation measure of Conty Estevez and Kulla (section 4.4) rises from pi for one direction to 4 pi for all. Its
    /// argument is taken from the mean axis' length r, which is (1 + cos) / 2 for a cone filled evenly, and its course is
    /// followed within three per cent by 1 - r^3. Squared diagonals stand in for areas: lights in one line have none.
    fn cost(&self) -> f64 {
        if self.count == 0 {
            return 0.0;
        }
        let mean = self.axis.length() / self.power;
        self.power * (self.max - self.min).length_squared() * (1.0 + 3.0 * (1.0 - mean * mean * mean))
    }
}

/// Reorders the group so that its first part, whose length is returned, and the rest become two nodes; neither is empty.
fn split(items: &mut [Item], depth: u32) -> usize {
    let half = items.len() / 2;
    // Halving reaches single lights within this many levels.
    let levels = usize::BITS - (items.len() - 1).leading_zeros();
    if depth + levels >= DEPTH_MAX {
        return half;
    }
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for item in &*items {
        min = min.min(item.centre());
        max = max.max(item.centre());
    }
    let extent = max - min;
    let mut best = None;
    for axis in 0..3 {
        if extent[axis] > 0.0 {
            // Thin slices are bad company: the regulariser of section 4.4.
            let thinness = extent.max_element() / extent[axis];
            best = cheapest(items, axis, min[axis], extent[axis], thinness, best);
        }
    }
    let Some(Split { axis, bucket, .. }) = best else { return half };
    let mut first = 0;
    for index in 0..items.len() {
        if bucket_of(&items[index], axis, min[axis], extent[axis]) < bucket {
            items.swap(first, index);
            first += 1;
        }
    }
    first
}

#[derive(Clone, Copy)]
struct Split {
    cost: f64,
    axis: usize,
    /// The first bucket of the second part.
    bucket: usize,
}

fn bucket_of(item: &Item, axis: usize, min: f64, extent: f64) -> usize {
    (((item.centre()[axis] - min) / extent * BUCKETS as f64) as usize).min(BUCKETS - 1)
}

fn cheapest(
    items: &[Item],
    axis: usize,
    min: f64,
    extent: f64,
    thinness: f64,
    mut best: Option<Split>,
) -> Option<Split> {
    let mut buckets = [Bucket::EMPTY; BUCKETS];
    for item in items {
        buckets[bucket_of(item, axis, min, extent)].add(item);
    }
    // Costs of what lies from each bucket on, from the right; then sweep from the left.
    let mut rest = [Bucket::EMPTY; BUCKETS + 1];
    for bucket in (0..BUCKETS).rev() {
        rest[bucket] = rest[bucket + 1].join(&buckets[bucket]);
    }
    let mut left = Bucket::EMPTY;
    for bucket in 1..BUCKETS {
        left = left.join(&buckets[bucket - 1]);
        if left.count == 0 || rest[bucket].count == 0 {
            continue;
        }
        let cost = thinness * (left.cost() + rest[bucket].cost());
        if best.is_none_or(|best| cost < best.cost) {
            best = Some(Split { cost, axis, bucket });
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use crate::light::{
        Emitter, Receiver,
        chooser::Chooser,
        testing::{Chance, Stage, floor},
    };
    use glam::Vec3;

    /// Small triangles scattered above the floor, some facing up, of very different strengths.
    fn scattered(count: u32, two_sided: bool) -> Stage {
        let mut chance = Chance(7);
        let mut stage = Stage { two_sided, ..Stage::default() };
        for _ in 0..count {
            let centre = chance.point() * Vec3::new(5.0, 1.0, 5.0) + Vec3::Y * 1.5;
            let (a, b) = (chance.direction() * 0.1, chance.direction() * 0.1);
            let radiance = 10.0_f32.powf(chance.next() * 4.0 - 2.0);
            stage = stage.with_triangle([centre, centre + a, centre + b], radiance);
        }
        stage
    }

    /// Irradiance on the floor without a tree: one light after the other.
    fn brute_force(stage: &Stage, receiver: &Receiver) -> f64 {
        let one = |index: usize| Stage {
            triangles: vec![stage.triangles[index]],
            radiances: vec![stage.radiances[index]],
            two_sided: stage.two_sided,
            ..Stage::default()
        };
        (0..stage.triangles.len()).map(|index| one(index).irradiance(receiver, 16).0).sum()
    }

    #[test]
    fn many_lights_through_the_tree_sum_to_what_each_gives_alone() {
        for two_sided in [false, true] {
            let stage = scattered(300, two_sided);
            assert_eq!(stage.build().report().tree_nodes, 599);
            for receiver in [floor(Vec3::ZERO), floor(Vec3::new(3.0, 0.9, -2.0))] {
                let expected = brute_force(&stage, &receiver);
                let (mean, error) = stage.irradiance(&receiver, 250);
                assert!((mean - expected).abs() < 4.5 * error, "{mean} +- {error}, expected {expected}");
                assert!(
                    error < 0.025 * expected,
                    "the tree does not find what matters: {error} of {expected}"
                );
            }
        }
    }

    #[test]
    fn a_hit_by_chance_is_told_the_density_of_the_choice() {
        let stage = scattered(500, true);
        let lights = stage.build();
        let mut chance = Chance(9);
        for normal in [None, Some(Vec3::Y), Some(Vec3::X)] {
            for _ in 0..5000 {
                let receiver = Receiver { point: chance.point() * 4.0, normal, time: 0.0 };
                let u = [chance.next(), chance.next()];
                let Some(sample) = lights.sample(&receiver, &stage, chance.next(), u) else { continue };
                let again = stage.pdf_of(&lights, &receiver, &sample);
                assert!((again / sample.pdf - 1.0).abs() < 1e-3, "{again}, chosen with {}", sample.pdf);
            }
        }
    }

    #[test]
    fn lights_are_chosen_as_often_as_their_probability_says() {
        let stage = scattered(40, true);
        let lights = stage.build();
        let view = floor(Vec3::ZERO).view();
        let Chooser::Tree(tree) = &lights.chooser else { panic!("40 lights make a tree") };
        let probabilities: Vec<f64> = (0..40).map(|light| tree.probability(&view, light)).collect();
        assert!((probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        const COUNT: u32 = 100_000;
        let mut counts = [0.0; 40];
        for i in 0..COUNT {
            let (light, probability) = tree.sample(&view, (f64::from(i) + 0.5) / f64::from(COUNT)).unwrap();
            assert!((probability / probabilities[light as usize] - 1.0).abs() < 1e-12);
            counts[light as usize] += 1.0;
        }
        for (count, probability) in counts.into_iter().zip(probabilities) {
            // Evenly spaced numbers fall into an interval of the unit line within one of its share.
            let expected = f64::from(COUNT) * probability;
            assert!(f64::abs(count - expected) <= 1.01, "{count} of {expected}");
        }
    }

    #[test]
    fn no_light_that_gives_light_is_without_a_chance() {
        for two_sided in [false, true] {
            let stage = scattered(200, two_sided);
            let lights = stage.build();
            let mut chance = Chance(31);
            for _ in 0..300 {
                let receiver =
                    Receiver { point: chance.point() * 6.0, normal: Some(chance.direction()), time: 0.0 };
                for primitive in 0..200 {
                    let [a, b, c] = stage.triangles[primitive];
                    let toward = ((a + b + c) / 3.0 - receiver.point).normalize();
                    let leaving = -toward.dot((b - a).cross(c - a).normalize());
                    let leaving = if two_sided { leaving.abs() } else { leaving };
                    if leaving > 1e-3 && toward.dot(receiver.normal.unwrap()) > 1e-3 {
                        let pdf = lights.pdf_triangle(&receiver, &stage, 0, primitive as u32, toward);
                        assert!(pdf > 0.0, "triangle {primitive} is never chosen from {receiver:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn of_many_thousand_triangles_the_one_that_matters_is_found() {
        let mut stage = Stage::default();
        for index in 0..100_000 {
            let corner = Vec3::new((index % 400) as f32, 50.0, (index / 400) as f32);
            stage.triangles.push([corner, corner + Vec3::X * 0.5, corner + Vec3::Z * 0.5]);
            stage.radiances.push(Vec3::splat(if index == 50_050 { 1e9 } else { 1e-3 }));
        }
        let receiver = floor(Vec3::new(200.0, 0.0, 100.0));
        let lights = stage.build();
        let mut chance = Chance(1);
        let found = (0..1000).filter(|_| {
            let u = [chance.next(), chance.next()];
            let sample = lights.sample(&receiver, &stage, chance.next(), u).unwrap();
            matches!(sample.emitter, Emitter::Triangle { primitive: 50_050, .. })
        });
        assert!(found.count() > 900);
    }

    #[test]
    fn lights_at_one_place_and_in_one_line_make_a_tree() {
        let mut stage = Stage::default();
        for index in 0..100 {
            let corner = Vec3::Y + Vec3::X * (index / 50) as f32;
            stage = stage.with_triangle([corner, corner + Vec3::X, corner + Vec3::Z], 1.0);
        }
        let (mean, error) = stage.irradiance(&floor(Vec3::ZERO), 100);
        let expected = brute_force(&stage, &floor(Vec3::ZERO));
        assert!((mean - expected).abs() < 4.5 * error, "{mean} +- {error}, expected {expected}");
        let lights: Vec<_> = (0..100).map(|i| lights_probability(&stage, i)).collect();
        assert!((lights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    }

    fn lights_probability(stage: &Stage, emitter: u32) -> f64 {
        stage.build().chooser.probability(&floor(Vec3::ZERO).view(), emitter)
    }
}
