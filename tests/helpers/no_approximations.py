"""Constants of the library that are no approximations, by package."""

from __future__ import annotations

NO_APPROXIMATIONS = {
    # by package: limits of values, units, guards against rounding, figures that were measured, defaults of fields
    "catalog": (
        # limits of files, tolerances of checks, drawings, blocks
        "BLOCK_BYTES BYTES_MAX CARDS_MAX CELLS_MAX COVERAGE_STATUS COVERAGE_UNKNOWN "
        "DIGEST_BYTES FLAG_MASKS HOLES_MAX LEVEL_FACTORS MAP_PX NO_CELL PATCHES_MAX POINTS_MAX "
        "RECENT_BYTES STEPS UNIVERSAL_SHARE UNKNOWN WORST _ATTRIBUTE_BYTES_MAX _CELLS_AT_ONCE "
        "_CENTRE_TOLERANCE_M _CHUNK_BYTES _CHUNK_BYTES_MAX _CURVE_STEPS _DEFLATE_MOST _DISC_PX "
        "_ELEVATION_LIMIT_M _ELLIPSE_PX _FEW_VALUES _GRATICULE_DEG _JSON_DEPTH _LIGHT "
        "_HALF_LETTER_PX _MAP_NODES _MAP_POINTS _MAP_PX _MARGIN_PX _MOST_NODES _NEAR _PLACE_TOLERANCE_M "
        "_POINTS_AT_ONCE _ROTATION_TOLERANCE _SECONDS _SECONDS_PER_MB _SIGMA_RATIO _TEXT_BYTES "
        "_TOPS_DEG _TOUCHING _TURNS _UNREACHED _WAITING_BYTES _WHOLE_BYTES "
        # 2 to 4: axes of a variable, level of compression
        "FIXED _DEFLATE"
    ),
    "dem": (
        # error models of products: published or fitted, overruled by `errors.height_sigma_m`, `--map-sigma` and maps
        "UNKNOWN_SIGMA_M _FAMILIES _TIES "
        # sizes of blocks and windows, limits of files, pictures, how a resolution is measured
        "BAND_EDGES_DEG BAND_PX BAND_SHARE BETWEEN_AREAS EDGE_PX EXPONENT EXPONENT_SIGMA "
        "FACTOR GREATEST_M HOLE_PX LAW_LONGEST_M MOON_KM2 PIXELS_MAX PLACES_MIN POLAR_ERROR "
        "POLAR_WITHIN_DEG POSSIBLE_M RADIUS_KM RECENT_PIXELS SHAPES WINDOW_PX _APART_M "
        "_ARC_MAX _AROUND _BINS_PER_OCTAVE _BLOCKS _BLOCKS _BLOCK_BYTES _BLOCK_PIXELS _BLOCK_PX _BRIGHTNESS "
        "_CHANCE _CLIP _COARSER _CONDITION "
        "_CROWDED _CUTS _DEGREE_M _DEGREE_M _EQUAL_PX _FITTED _FULLY _FURTHEST_DEG _GAP_PX _KM "
        "_KM_SIDE_M _LATTICE _LEAST _LEAST _LEAST_SHARE _LONGEST _MISFIT _MOST _MOST_PRODUCTS "
        "_NARROWEST _NARROW_DEG _NODES _NOISES _OCTAVES_LEAST _OPEN_FILES _PAD _PAIRS "
        "_REPEATED _ROUNDS _ROWS_DEG _SEAM_MAX_DEG _SHORTEST _SLACK _SLOPE _SPARE_PX "
        "_ARCHIVE_BYTES_S _OPENING_S "
        "_STEPS_DEG _STEP_PX _STEP_SHARE _STRETCHED _TILE_BLOCKS _TILE_PIXELS _TILE_PX _TOLD _TRIED _UNKNOWN_TIE_M "
        "_WINDOW_PIXELS _WINDOW_PIXELS _ZEROS_PX "
        # tables of whole numbers
        "GAP GDAL_CACHE_BYTES INK LIMIT_BYTES PAPER PRODUCT_COLOURS TILES _CACHED_PIXELS "
        "_EDGE_POINTS _EDGE_POINTS_OF_SIDE _HATCH _HEAD_BYTES _HIGH _MANY _MARGIN _PACKED "
        "_POLAR _SWATCH _WIDE _XML_BYTES "
        # 2 to 4: windows read or kept, the least side, steps and rounds of a measurement
        "ACROSS DOWN REACH RECENT _MARGIN _ROUNDS _SIDE_MIN"
    ),
    "kernels": (
        # values of single precision, guards against rounding, numbers of results and of what is done at once
        "AT_ONCE BAND_ROWS COT_SMOOTH COS_HELD DISC_NUMBERS FACET FLAT FREE HEAD IN_PLANE LEAST UNKNOWN "
        "LINES LOOKS LOOSE LOWEST NEAR_CAMERA NEVER NOWHERE NUMBERS NUMBERS NUMBERS ON_GRID "
        "ON_LINE ON_SURFACE_M PATIENCE RAYS READS ROWS SMALL SMALL_CELLS SNAP STEEPER SUNS TILE TILE TILES "
        "UNDERGROUND_M _ABOVE _ALONG _BAND_ROWS _BIAS _BITS _CLASS _CLASSES _DETERMINED _ENDLESS "
        "_EDGE_DEG _FAR _FLAT _FLOOR _GONE _HALF _HALF _INF _INV_PI _INVERSE_ROOT_TWO_PI _KEPT _LANES "
        "_LEAST_VARIANCE _LN2 _LOG2E _LOWEST _NAN _NARROW _NEAR _ONE _ONE _ONE _PARTS "
        "LINKED _PARTS _PARTS _ROOT_HALF _RUN _RUN _RUN _SHIFT _SMOOTH _SPLITTER _SQRT_HALF _STEEP "
        "_STEPS _STEPS _STEPS _STEPS _STEPS _TAIL_END _TEXTURED _THRESHOLDS _TINY _TINY _TOUCHING _TWO "
        "_TWO_PI _UNSORTED _ZERO _ZERO "
        # integrals whose rest is below 1e-6, bounds with their margins, the fit of a match, whose sigma is measured
        "_APART _AT32 _FARTHEST_PX _FEWEST _LAST_STEP_PX _LONGER "
        "_SETTLED_PX _SIGMAS _SURE _WEIGHTS32 _WHOLE_WEIGHTS points._MARGIN "
        # tables of whole numbers
        "POLAR_COS POLAR_SIN SIGMA_C SIGMA_P U_P V_P "
        # 2 to 4: codes of laws, sums in registers, fields of a product, the level where a ray starts
        "CAMERA_LEVEL FIELDS HAPKE LUNAR_LAMBERT MINNAERT PAIRS matching.template_products._FEW _ROWS _STRIP _TILE"
    ),
    "landmarks": (
        "BLOCK BOUND_WORK CONTRASTS FARTHEST_PX FEWEST GATE HARRIS_K ID_ROWS "
        "MOST_POINTS MOST_SLACK_PX SIGNIFICANT UNITS_MAX "
        "_CERTAIN _EXPONENTS _FLAT _LEAST_PERCENT _LEAST_VARIANCE _NEGLIGIBLE "
        "_ROUNDING "
        # tables of whole numbers
        "BOUND_STEPS _ID_STRIDE "
        # 2 to 4: unknowns of a camera, candidates of a cell, stages, places of a part
        "GROUP_EXTRA SPARE_STAGE USABLE_STAGE _MINIMAL _PLACES_LEFT"
    ),
    "light": (
        "CLEAR_SKY_RATIO DARKEST_SHARE EARTH_RADIUS_M HIGH_DEG "
        "MOST_SOURCES SEGMENT_DEG WIDEST_DEG _FLAT _FULL_SCALE _GOLDEN _J2000 "
        "_LOWEST_DEG _NEVER_UP_RAD _ROUNDING_DEG _SHIFTS _TAIL _WHITE_PERCENTILE "
        # tables of whole numbers
        "CHUNK _BLOCK_NODES _RANGE_PIXELS _RAYS "
        # 2 to 4: pixels of a plateau
        "_FLAT_PIXELS"
    ),
    "photometry": (
        "ALBEDO BOUNDS DISCS INTERVALS LAMBERT_ALBEDO LARGEST_EMISSION_DEG LEAST_POINTS LIMITS "
        "MEAN MINNAERT_ALBEDO MINNAERT_FLOOR MINNAERT_K OPTICS REC_709 SETS "
        "SINGLE_SCATTERING_ALBEDO SURFACES TABLE_1 TABLE_2 TABLE_3 WEIGHT _BLOCK_ROWS _DENSEST "
        "_GAIN _GAP_DEG _LEVEL_DEG _NO_CONTRAST _RANGES "
        "_SAMPLE_NODES _STARTS _STEPS _SWEEPS _THETA_DEG _UNIT "
        # 2 to 4: starts of a fit that are refined: as good as five
        "_REFINED"
    ),
    "production": (
        "AREAS_MAX AREA_NODES_MIN BANDS_DEG CONDITIONS_MAX COVERAGE_BYTES COVERAGE_CELLS "
        "FOOTPRINT_MAX_KM FOOTPRINT_NODES FOOTPRINT_PATCHES LARGE_NODES LENGTH_MAX_M LEVELS_MAX LEVEL_FACTOR_MAX "
        "LOCATED LOCATED_MAX LOCATED_MIN OVERVIEW_NODES PART_STEP PER_VIEW_MAX "
        "POLAR_ELEVATIONS_DEG POLAR_SUN_DEG SEARCH_MAX_M SEARCH_NODES SPACING_MAX_M "
        "SUN_ELEVATIONS_DEG TURNED_DEG TURNED_MOST _BALL_NODES _BATCH_NODES _BYTES_BESIDE "
        "_CURVE_STEPS _ERROR_PLACES _FILE_BYTES recipe._FINEST "
        "_LATTICE_MAX _LEAST_CHANCE _LEAST_M _LINKS _MIDDLE _NODES_MOST _PAIRS_MOST "
        "_PROCESSES _READ_AT_ONCE _READ_BYTES_S _READ_SHARE "
        "_SAMPLED _SAMPLES _SHORT _SHOWN _SLACK_RAD _TOGETHER _WORST "
        # tables of whole numbers
        "BLOCK_BYTES SEARCH_MAX_NODES SPACING_MIN_NODES _DISC _DISCS _EVALUATED _RANK "
        "_READ_BYTES _SMALL_BYTES "
        # 2 to 4: fields of a table, borders, groups of Suns
        "CORNER_BORDER SECTORS SITE"
    ),
    "rendering": (
        "DISC_SHIFT DISC_SHIFT_DEG NORMAL_ROUNDING_RAD PROBES_MOST RING_MAX_M SIZE_MAX_KM STORED "
        "TILE WHITE_PERCENTILE _AXIS_STEPS _BLOCK_ROWS _BLOCK_ROWS _CELLS_MOST _EXTENT_MAX_M "
        "_FACING _GAMMA _MARGIN _NODES _RADIUS_UP _SAMPLES _SAMPLES _SHAPE _SLOPE_NODES _TURNS "
        "_WHITE_PERCENTILE "
        # tables of whole numbers
        "_BLOCK_PIXELS _CHUNK _CORNERS_AT_ONCE _PIXELS_AT_ONCE _RUNGS "
        # 2 to 4: least side of a block
        "_CELLS_LEAST"
    ),
    "terrain": (
        "BLOCK_ROWS CELL_PER_RESOLUTION LOCAL_MAX_DEG OFF_SHARE STEEPEST _BLOCK_NODES _EDGE "
        "_ITERATIONS _LEAST_STRIDE _LIMB _NODES_MAX _PLACES _ROUNDING _SLACK_OCTAVES _TOLERANCE_M "
        # tables of whole numbers
        "_BLOCK _BLOCKS "
        # 2 to 4: a level of a pyramid
        "_TILE"
    ),
    "matching": (
        # method of a search in an image and of a fix: what is accepted is judged by its number of false alarms
        "AS_STATED FAINT FAR_TURNS_DEG HIGHEST_RAD HUBER "
        "LEAST_ELEVATION_DEG LEAST_GAIN LEAST_LIKENESS LEAST_SIGMA_PX "
        "LEAST_TURN_DEG LEAST_USABLE LOWERED MISSING NO_CLAIM RAISED "
        "RAISE_LIMITS_DEG RESOLUTION_SHARE SHARE_IF_HERE SHOWS SIGMAS STEP_PX TURNS_DEG "
        "USUAL _AT_EDGE _BACK_COVER _BACK_REACH _CHUNK _CHUNK _CHUNK _CHUNK _ENOUGH _NEARLY "
        "_CHUNK_OFFSETS _CHUNK_PX _CONDITION _CONE_MARGIN _CONTRASTS _CONVERGED _DRAWS _FARTHEST _FARTHEST "
        "_FEW _FEWEST _FILL_PX _FLOOR_PX _GLANCE_POINTS _GRID_PX _HIGHEST _INNER _KEPT _LEAST _LEAST_CELLS "
        "_LEAST_MOVING _LEAST_REAL _LEAST_SHARE _LEVELS _LOOKED_AT _LOOSEST _MOST _MOST_NEEDED "
        "_MOST_POINTS _MOST_SIGMA_PX _NARROWEST_PX _NEARLY_ALL _NEAR_PX _PIXEL_M _PLATEAU _POWER_STEP _POWER_STEPS "
        "_OTHERWISE_DEG _REACH_PX _ROUNDS _ROUNDS _SAME_PX SEEN_DEG _SETS _SETTLED _SMALLEST_PX "
        "_STEPS _STILL _SUB _SURE_SHARE _TELLS _TURN_SIGMAS _UP "
        "_WIDEST_PX _WIDEST_PX "
        # 2 to 4: passes that end when nothing moves, what is tried first
        "SIDEWAYS_DEG _GLANCE _PASSES _READ_PX _ROUGH _SUN_PX"
    ),
    "cameras": (
        # limits of files, steps of iterations that end at a tolerance, what a warning says, blocks
        "BEYOND CORNER_PX FARTHEST_M FRAME_PIXELS_MAX LARGEST ORIGIN_HEIGHT_M SUN_NEAREST_M "
        "_ALIKE_DEG _AT_ONCE _BACK _CENTURY_S _COARSEST_MM _COARSE_M _COMPLEX_STEP _CONVERGED "
        "_DEEPEST_M _DOWN_DEG _ENDS_S _GRID _JUMP _KNOTS _MEAN_EARTH _MEAN_EARTH _MOST_STEPS "
        "_NAC _NO_TERM _OFF_CENTRE _RADIUS_TOLERANCE _RECORD _ROTATION_TOLERANCE _ROWS "
        "_SAME _SKEWEST _SPARE _STEPS _SUN_M _TOLERANCE _TURNED_ROUND_RAD _UNIT _UNITS_M "
        "_UNIT_TOLERANCE _UP _VELOCITY_M _VELOCITY_SHARE _WIDEST_DEG _WINDOWS "
        # 2 to 4: what a warning names, units of keywords
        "KEYWORDS _MOST"
    ),
    "navigation": (
        # drawings, limits of files, blocks
        "FIRST_SIGMAS FRAMES FRAMES_MAX NUMBERS_SHOWN PAIRS_AT_ONCE PROMISED WHOLE _BOTTOM _COUNTS _DRAWN _FIELD_DEG _GRID _HEIGHT "
        "_LEFT _LOW_DEG _MOSTLY _RIGHT _TICKS _TOP _UNITS _UNIT_TOLERANCE _WIDTH _WIDTH "
        # 2 to 4: what a message names, points of a position
        "LEAST_POINTS _NAMED"
    ),
    "geometry": (
        # limits of maps
        "RADIUS_RANGE_M _EDGE _POLAR_REACH_DEG"
    ),
    "exports": (
        # limits and fields of formats, blocks
        "ALONE_S DEPENDENT GAP_S NONE NO_SUN PLATES_MAX STEPS TILE_POINTS _ANGLES _ARCSECOND "
        "_BLOCK_BYTES _CENTURY_S _DEGREE _FINE_SCALE _INDEX _LARGEST _LONGEST_S _LONGEST_S "
        "_MOON _MOST_MB _NAMES _NODES _RECORD _ROOM_BYTES _SIDE _UNKNOWN _VOXELS_AND_LISTS "
        "_WORK "
        # 2 to 4: fields and scales of formats
        "_COARSE_SCALE _HEAD"
    ),
    "simulation": (
        # limits of a detector, blocks
        "BITS_MAX BLUR_MAX_PX BRIGHT_PERCENTILE BRIGHT_SHARE _LIT_SHARE _RAYS_AT_ONCE _SHARP_PX"
    ),
    "images": (
        # limits of files, codes of formats, blocks
        "DEEP_SHARE LEAST_DEPTH_M LEAST_RELIEF_M LONGEST_SPAN_S PLATEAU_FACTOR PLATEAU_LEAST "
        "_FLOAT_CODES _INTEGER_CODES _MOST_PIXELS _WINDOWS _WINDOW_PX "
        # 2 to 4: pixels beside a plateau
        "PLATEAU_NEIGHBOURS"
    ),
    "ephemeris": (
        # calendars, decimals that are shown, limits
        "DECIMALS ERROR_YEARS FIRST_YEAR LAST_YEAR MOST_INSTANTS SUNS_DIFFER_DEG "
        "_AHEAD_OF_TAI_S _CHUNK _SECONDS"
    ),
}
"""Other constants of floating point, and whole numbers above 1; a new one belongs here, once for each module
that has it, or in the registry."""
