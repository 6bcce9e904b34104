//! One reference view against its sources: bands of rows to points, or to the depths of the next
//! pass.

use super::confident::{Confident, Rows};
use super::consensus::Consensus;
use super::counts::FuseCounts;
use super::finish::{Add, BlockPoints, Face, Frame, Gather, Locate, Mean, Place, Room, entries};
use super::kernel::{BLOCK, Block, Seen};
use super::normals;
use super::options::{Colors, FuseOptions};
use super::packing::{Packing, STRIP, Take};
use super::points::{Columns, Points};
use super::rows::{BandBytes, add_to_rows};
use super::rules::{Against, Bounds, Case, Court, Kept, Rule, Verdict};
use super::samples::Samples;
use super::sampling;
use super::source::{Photo, Source, SourceImage};
use crate::ahead::prefetch;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, Raster, View};
use pulp::Arch;
use std::ops::Range;
use std::sync::Arc;

/// One in so many pixels of a block is asked for ahead: its neighbours lie in the same cache line or near.
const ASKED: usize = 8;

/// Tells whether a world point is wanted.
pub type Region<'a> = dyn Fn(DVec3) -> bool + Sync + 'a;

/// A reference view with all that its pixels are tested against.
pub(super) struct Reference<'a> {
    /// The view's number.
    pub(super) number: usize,
    pub(super) view: &'a View,
    pub(super) samples: Arc<Samples>,
    /// Which of its pixels count, where that is not decided yet.
    pub(super) confident: Option<Confident>,
    pub(super) sources: Vec<Source>,
    pub(super) options: &'a FuseOptions,
    pub(super) rule: Rule,
    /// Sources that must agree.
    pub(super) needed: usize,
    /// Whether fewer do where nobody else can judge.
    pub(super) soften: bool,
}

/// What a band of rows becomes; its memory is used again.
#[derive(Default)]
pub(super) struct Band {
    /// The points of each row, if they are not wanted as bytes.
    pub(super) rows: Vec<Points>,
    /// The same as bytes.
    pub(super) bytes: BandBytes,
    /// What became of the pixels.
    pub(super) counts: FuseCounts,
    /// Room for the band's own depths.
    room: Vec<f32>,
}

/// What only finished points need.
pub(super) struct Finish<'a> {
    pub(super) frame: Frame,
    /// The sources' centres in the world.
    pub(super) centers: Vec<DVec3>,
    pub(super) columns: Columns,
    /// The columns of rows of bytes, where those are wanted.
    pub(super) as_bytes: Option<Columns>,
    pub(super) photo: Option<Arc<Photo>>,
    pub(super) confidence: Option<Raster<f32>>,
    pub(super) normals: Option<NormalMap>,
    pub(super) region: Option<&'a Region<'a>>,
}

impl Reference<'_> {
    /// Puts the depths of the next pass for `rows` into `stored`, those rows of a bordered map of
    /// zeros. Pixels on which too few sources agree are left out and counted.
    pub(super) fn new_depths(&self, rows: Range<usize>, stored: &mut [f32]) -> FuseCounts {
        let first = (rows.start + 1) * self.samples.stride();
        let mut counts = FuseCounts::default();
        let unit = self.samples.unit();
        let kept = match self.rule {
            Rule::Median => Kept::Words,
            _ => Kept::Nothing,
        };
        self.for_each_block(
            rows,
            (Rows::all(&self.samples), kept),
            |_| (),
            |block, _, consensus| {
                let mut fused = [0.0; BLOCK];
                let depths = block.depth.iter().zip(&consensus.delta);
                for (fused, (depth, delta)) in fused.iter_mut().zip(depths) {
                    *fused = unit.convert(depth + delta);
                }
                // Each is written once, over a zero, so nothing hangs on which.
                let entries = fused.iter().zip(&consensus.enough).zip(&block.place);
                for ((&fused, &enough), &place) in entries.take(block.len) {
                    stored[place as usize - first] = if enough { fused } else { 0.0 };
                    counts.inconsistent += u64::from(!enough);
                }
            },
        );
        counts
    }

    /// Puts the points of `rows` into `band`, and what became of the pixels that had a depth.
    pub(super) fn points(&self, rows: Range<usize>, finish: &Finish<'_>, band: &mut Band) {
        band.rows.resize_with(rows.len(), Points::default);
        band.rows.iter_mut().for_each(Points::clear);
        if let Some(columns) = finish.as_bytes {
            let most = self.samples.columns().len();
            band.bytes.begin(rows.len(), most, columns);
        }
        if rows.is_empty() {
            band.counts = FuseCounts::default();
            return;
        }
        let mut counts = FuseCounts::default();
        let mut room = Room::new(self.sources.len());
        let own = match &self.confident {
            Some(confident) => {
                let (own, unconfident) =
                    confident.band(&self.samples, rows.clone(), &mut band.room);
                counts.unconfident = unconfident;
                own
            }
            None => Rows::all(&self.samples),
        };
        let ahead = |block: &Block| self.ask(block, finish);
        let from = (own, self.kept(finish));
        self.for_each_block(rows.clone(), from, ahead, |block, seen, consensus| {
            self.place((block, seen, consensus), finish, &mut room);
            let kept = self.judge((block, consensus), (finish, &room), &mut counts);
            if kept == 0 {
                return;
            }
            self.describe(kept, (block, seen), (finish, own), &mut room);
            let points = BlockPoints {
                block,
                consensus,
                room: &room,
                first_row: rows.start,
                confidences: self.confidences(finish),
                photo: self.copied_photo(finish),
            };
            if let Some(columns) = finish.as_bytes {
                return add_to_rows(columns, &points, kept, &mut band.bytes);
            }
            for i in entries(kept) {
                let row = &mut band.rows[points.row(i)];
                row.add(finish.columns, &points, i);
                if finish.columns.has(Columns::VISIBLE) {
                    self.add_visible(i, seen, row);
                }
            }
        });
        band.counts = counts;
    }

    /// What finished points need of what sources say.
    fn kept(&self, finish: &Finish<'_>) -> Kept {
        if finish.columns.has(Columns::COLORS) && self.options.colors == Colors::Mean {
            Kept::Positions
        } else if self.rule == Rule::Disparity || finish.columns.has(Columns::VISIBLE) {
            Kept::Words
        } else {
            Kept::Nothing
        }
    }

    /// Asks for what finished points of the block need of the reference itself.
    fn ask(&self, block: &Block, finish: &Finish<'_>) {
        let photo = finish
            .photo
            .as_ref()
            .filter(|photo| self.is_as_large(photo));
        let confidences = self.confidences(finish);
        for i in (0..block.len).step_by(ASKED) {
            if let Some(photo) = photo {
                prefetch(photo.part.values(), photo.place(block.at(i)));
            }
            if let Some(confidences) = confidences {
                prefetch(confidences, block.pixel[i] as usize);
            }
        }
    }

    /// A bit for each entry that becomes a point; what becomes of all is counted.
    fn judge(
        &self,
        (block, consensus): (&Block, &Consensus),
        (finish, room): (&Finish<'_>, &Room),
        counts: &mut FuseCounts,
    ) -> u64 {
        let enough = room.enough(block.len);
        counts.inconsistent += block.len as u64 - u64::from(enough.count_ones());
        let mut kept = enough;
        if self.options.guard {
            for i in 0..block.len {
                let contradicted = consensus.violations[i] > consensus.count[i];
                kept &= !(u64::from(contradicted) << i);
            }
            counts.contradicted += u64::from((enough & !kept).count_ones());
        }
        if let Some(wanted) = finish.region {
            let agreed = kept;
            for i in entries(agreed) {
                kept &= !(u64::from(!wanted(room.position(i))) << i);
            }
            counts.outside += u64::from((agreed & !kept).count_ones());
        }
        counts.fused += u64::from(kept.count_ones());
        kept
    }

    /// Calls `f` with every block of pixels that have a depth, and what the sources say, as far as it is `kept`;
    /// `ahead` with the block before they are asked. Blocks are taken from the rows of one strip of columns after the other.
    fn for_each_block(
        &self,
        rows: Range<usize>,
        (own, kept): (Rows<'_>, Kept),
        ahead: impl Fn(&Block),
        mut f: impl FnMut(&Block, &[Seen], &Consensus),
    ) {
        fn against(source: &Source) -> Against<'_> {
            Against {
                pair: &source.pair,
                samples: &source.samples,
                disparity: source.disparity,
            }
        }
        let sources: Vec<Against<'_>> = self.sources.iter().map(against).collect();
        let court = Court {
            rule: self.rule,
            taps: self.rule.taps(self.options),
            bounds: Bounds::new(self.view, self.options),
            needed: u32::try_from(self.needed).unwrap_or(u32::MAX),
            soften: self.soften,
            kept,
            sources: &sources,
        };
        let mut verdict = Verdict::new(&sources, kept);
        let arch = Arch::new();
        let mut block = Block::new();
        let mut finish = |packing: &mut Packing| {
            let (grid, unit) = (self.samples.grid(), self.samples.unit());
            let block = &mut block;
            arch.dispatch(Take {
                packing,
                block,
                grid,
                unit,
            });
            ahead(block);
            arch.dispatch(Case {
                court,
                block,
                verdict: &mut verdict,
            });
            f(block, &verdict.seen, &verdict.consensus);
        };
        let mut packing = Packing::new();
        let stored = self.samples.columns();
        let extents = || rows.clone().map(|row| self.samples.extent(row));
        let filled = || extents().filter(|extent| !extent.is_empty());
        let first = filled().map(|extent| extent.start).min().unwrap_or(0);
        let end = filled().map(|extent| extent.end).max().unwrap_or(0);
        for left in (first / STRIP * STRIP..end).step_by(STRIP) {
            let right = (left + STRIP).min(stored.end);
            let left = left.max(stored.start);
            for row in rows.clone() {
                let values = own.part(row, left..right);
                // Values are ≥ 0: no bit is set where there is no depth.
                if values.iter().fold(0, |bits, value| bits | value.to_bits()) == 0 {
                    continue;
                }
                #[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
                packing.add((left as u32, row as u32), values);
                if packing.is_full() {
                    finish(&mut packing);
                }
            }
        }
        if !packing.is_empty() {
            finish(&mut packing);
        }
    }

    /// Computes the block's positions.
    fn place(
        &self,
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
        room: &mut Room,
    ) {
        let arch = Arch::new();
        arch.dispatch(Place {
            frame: &finish.frame,
            block,
            consensus,
            room,
        });
        if self.rule == Rule::Disparity {
            arch.dispatch(Gather {
                centers: &finish.centers,
                seen,
                consensus,
                room,
            });
        }
    }

    /// Finds normals and colours of the entries whose bits are `kept`.
    fn describe(
        &self,
        kept: u64,
        (block, seen): (&Block, &[Seen]),
        (finish, own): (&Finish<'_>, Rows<'_>),
        room: &mut Room,
    ) {
        if finish.columns.has(Columns::NORMALS) {
            match &finish.normals {
                Some(map) => {
                    for i in entries(kept) {
                        let in_cam = map.values()[block.pixel[i] as usize];
                        let given = normals::given(in_cam, &self.view.camera, block.at(i));
                        let normal = given.map_or(Vec3::ZERO, |normal| self.to_world(normal));
                        room.set_normal(i, normal);
                    }
                }
                None => self.fit_normals(kept, block, (&finish.frame, own), room),
            }
        }
        if let (true, Some(photo)) = (finish.columns.has(Columns::COLORS), &finish.photo)
            && !self.copies_colors(photo)
        {
            self.mix_colors(kept, (block, seen), photo, room);
        }
    }

    /// Adds the views that see a point.
    fn add_visible(&self, i: usize, seen: &[Seen], points: &mut Points) {
        points.visible_in.push(number(self.number));
        let pairs = self.sources.iter().zip(seen);
        let agreeing = pairs.filter(|(_, seen)| seen.agrees[i] == 1);
        let numbers = agreeing.map(|(source, _)| number(source.number));
        points.visible_in.extend(numbers);
    }

    /// The reference's confidences, row-major.
    fn confidences<'a>(&'a self, finish: &'a Finish<'_>) -> Option<&'a [f32]> {
        let own = self.confident.as_ref();
        let own = own.map(|own| own.confidences.as_slice());
        own.or(finish.confidence.as_ref().map(Raster::values))
    }

    /// Whether a photograph has the size of the depth map.
    fn is_as_large(&self, photo: &Photo) -> bool {
        photo.size == (self.view.camera.width(), self.view.camera.height())
    }

    /// Whether points have the colours of pixels of the reference's photograph.
    fn copies_colors(&self, photo: &Photo) -> bool {
        self.options.colors == Colors::Reference && self.is_as_large(photo)
    }

    /// The photograph whose pixels' colours points have, if they have those.
    fn copied_photo<'a>(&self, finish: &'a Finish<'_>) -> Option<&'a Photo> {
        let photo = finish.photo.as_deref();
        photo.filter(|photo| finish.columns.has(Columns::COLORS) && self.copies_colors(photo))
    }

    /// Fits planes to the depths around the entries whose bits are `kept`; zero where there is none.
    fn fit_normals(
        &self,
        kept: u64,
        block: &Block,
        (frame, own): (&Frame, Rows<'_>),
        room: &mut Room,
    ) {
        let (unit, similar) = (self.samples.unit(), self.options.similar_depth);
        room.copy_windows(block, own);
        Arch::new().dispatch(Face {
            frame,
            block,
            unit,
            similar,
            room,
        });
        for i in entries(kept & !room.whole()) {
            let window = (&room.window(i), unit);
            let gappy = normals::from_window(window, &self.view.camera, block.at(i), similar);
            room.set_normal(i, gappy.map_or(Vec3::ZERO, |normal| self.to_world(normal)));
        }
    }

    fn to_world(&self, in_cam: Vec3) -> Vec3 {
        let normal = self.view.pose.direction_to_world(in_cam.as_dvec3());
        normal.as_vec3()
    }

    /// Mixes the colours of the reference's photograph, or the means over all that agree: the reference's
    /// bilinear, a source's at its nearest pixel.
    fn mix_colors(
        &self,
        kept: u64,
        (block, seen): (&Block, &[Seen]),
        photo: &Photo,
        room: &mut Room,
    ) {
        if self.is_as_large(photo) {
            room.own_colors(kept, |i| photo.part.values()[photo.place(block.at(i))]);
        } else {
            let scale = self.scale(&photo.part);
            let center = |i: usize| DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
            room.own_colors(kept, |i| sampling::color(&photo.part, center(i) * scale));
        }
        if self.options.colors == Colors::Reference {
            return room.keep_colors();
        }
        let arch = Arch::new();
        // Source by source, so that the fetches from its image do not wait for each other.
        let images = || {
            let images = self.sources.iter().map(|source| source.image.as_ref());
            let asked = images.zip(seen).enumerate();
            asked.filter_map(|(at, (image, seen))| Some((at, image?, seen)))
        };
        for (at, SourceImage { photo, scale }, seen) in images() {
            arch.dispatch(Locate {
                seen,
                scale: *scale,
                corner: photo.corner,
                size: photo.part.size(),
                to: (at, room),
            });
            room.ask(at, kept, photo);
        }
        for (at, SourceImage { photo, .. }, seen) in images() {
            room.fetch(at, kept, photo);
            arch.dispatch(Add {
                agrees: &seen.agrees,
                to: (at, room),
            });
        }
        arch.dispatch(Mean(room));
        room.keep_colors();
    }

    /// Image pixels per depth pixel.
    fn scale(&self, image: &ColorImage) -> DVec2 {
        DVec2::new(
            f64::from(image.width()) / f64::from(self.view.camera.width()),
            f64::from(image.height()) / f64::from(self.view.camera.height()),
        )
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}
