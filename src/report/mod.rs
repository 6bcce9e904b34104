//! Records to files that people read. Pure: values in, bytes out.

mod basis;
mod canvas;
pub mod check;
mod cloud_payload;
pub mod cloud_picture;
pub mod colormap;
pub mod compare;
pub mod contact_sheet;
pub mod curve_png;
pub mod curve_svg;
pub mod folder;
mod font;
pub mod histogram_svg;
pub mod html;
pub mod leaderboard;
mod leaderboard_tables;
mod lines;
pub mod record;
pub mod table;
pub mod table_csv;
pub mod table_md;
pub mod table_tex;
mod thresholds;
