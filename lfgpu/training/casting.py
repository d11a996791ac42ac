"""Ray casting of generated scenes: the views of an array of cameras, and the exact disparity of the reference.

Scenes live in *disparity space*: a point is (X, Y, d), its place in the reference view in pixels and its disparity. The
pixel (x, y) of the view at offset o sees the points (x + d o_x, y + d o_y, d). These are straight lines, so planes stay
planes and quadrics stay quadrics, and the truth is a root, not a search. The nearest point is that of largest d.
Offsets are relative to the farthest view: |o| is at most 1, and d is the shift in that view, in pixels.
"""

import warp as wp

from lfgpu.training.textures import SMOOTH

wp.set_module_options({"fast_math": True})

SHEET, QUADRIC, BOX = range(3)
"""Shapes: a plane that a mask cuts out, an ellipsoid or a cylinder, a box."""

WHOLE, RECTANGLE, ELLIPSE, BLOB, BARS, NET, LEAVES, HOLES, TORN = range(9)
"""Masks of sheets."""

PLAIN, STRIPES, CHECKS, BRICKS, DOTS, PATCHES = range(6)
"""Patterns on surfaces."""

_SMOOTH = wp.constant(SMOOTH)
_NOWHERE = wp.constant(-1e8)
_APART = wp.constant(1e-3)  # disparity by which a shadow ray leaves its surface


@wp.struct
class Shape:
    """The geometry of a primitive; those of a scene are sorted by the largest disparity in their bounds."""

    kind: wp.int32
    mask: wp.int32
    seed: wp.int32
    centre: wp.vec3f  # place in the reference view, pixels, and disparity
    axis: wp.vec2f  # cosine and sine of the angle of its first side
    size: wp.vec3f  # half sides: pixels, pixels, disparity
    slope: wp.vec2f  # change of disparity with x and y
    tilt: wp.vec2f  # shear of its sides along the line of sight, per unit of disparity
    roundness: wp.float32  # 1 for ellipsoids, 0 for cylinders
    period: wp.vec2f  # distance of bars, leaves or holes, pixels
    fill: wp.vec2f  # share of a period that is solid
    relief: wp.float32  # height of waves on a sheet, disparity
    waves: wp.mat33f  # three of these waves, a row each: radians per pixel in x and in y, and the phase
    reach: wp.vec3f  # bounds around the centre: half the width and height in pixels, and half the disparities


@wp.struct
class Look:
    """The appearance of a primitive; colours and intensities are as displayed, 0 to 1."""

    colour: wp.vec3f
    second: wp.vec3f
    texture: wp.int32
    frame: wp.vec4f  # cosine and sine of the angle of the texture times its scale, and its place
    contrast: wp.float32
    pattern: wp.int32
    cell: wp.vec2f  # sides of a cell of the pattern, pixels
    strength: wp.float32  # of the pattern
    shading: wp.vec2f  # change of light across the primitive
    gloss: wp.float32  # strength of a highlight, which moves over the surface by `drift` pixels in the farthest view
    spot: wp.vec3f  # place of the highlight relative to the centre and its radius, pixels
    drift: wp.vec2f
    mirror: wp.float32  # share of the light that is mirrored from a texture at the disparity `mirrored`
    mirrored: wp.float32
    glow: wp.float32  # light of its own


@wp.struct
class Light:
    """The light and the cameras of a scene."""

    direction: wp.vec3f  # towards the lamp, in disparity space: pixels, pixels, disparity
    radius: wp.float32  # of the lamp, as a share of the direction: soft shadows
    shadow: wp.float32  # share of the light that a shadow takes
    haze: wp.float32  # strength of large smooth shadows from outside of the picture
    haze_scale: wp.float32
    exposure: wp.float32
    pixel: wp.float32  # side of the square that a pixel sees, in pixels
    gamma: wp.float32  # exponent from linear light to intensity is 1 / gamma
    vignetting: wp.float32  # loss of light in the corners
    aperture: wp.float32  # half side of the lens, relative to the distance of the farthest view
    focus: wp.float32  # disparity that is sharp
    read: wp.float32
    shot: wp.float32  # noise: sqrt(read^2 + shot^2 intensity)
    levels: wp.float32  # the largest code of the camera


@wp.func
def _spread(k: int, start: float) -> wp.vec2f:
    """Give the k-th place of a row of places that cover the square [-0.5, 0.5)^2 evenly (the R2 sequence).

    All pixels and views use the same places: with random ones, soft shadows and blurred views would have grain.
    """
    u = start + 0.7548777 * float(k)
    v = start + 0.5698403 * float(k)
    return wp.vec2f(u - wp.floor(u) - 0.5, v - wp.floor(v) - 0.5)


@wp.func
def _random(a: int, b: int, c: int) -> float:
    """Give a number in [0, 1) to three integers."""
    return wp.randf(wp.rand_init(a * 7919 + b, c * 104729 + b * 31))


@wp.func
def _fraction(x: float) -> float:
    return x - wp.floor(x)


@wp.func
def _sample(textures: wp.array3d(dtype=wp.vec3f), index: int, x: float, y: float) -> wp.vec3f:
    """Interpolate a texture, which repeats itself."""
    side = textures.shape[1]
    fx = wp.floor(x)
    fy = wp.floor(y)
    ax = x - fx
    ay = y - fy
    x0 = int(fx) % side
    y0 = int(fy) % side
    if x0 < 0:
        x0 = x0 + side
    if y0 < 0:
        y0 = y0 + side
    x1 = (x0 + 1) % side
    y1 = (y0 + 1) % side
    upper = textures[index, y0, x0] * (1.0 - ax) + textures[index, y0, x1] * ax
    lower = textures[index, y1, x0] * (1.0 - ax) + textures[index, y1, x1] * ax
    return upper * (1.0 - ay) + lower * ay


@wp.func
def _leaf(shape: Shape, u: float, v: float) -> bool:
    """Say whether a place on a sheet lies in one of its leaves, of which most cells of a lattice have one."""
    x = u / shape.period[0]
    y = v / shape.period[1]
    column = int(wp.floor(x))
    row = int(wp.floor(y))
    found = bool(False)
    for k in range(9):
        i = column + k % 3 - 1
        j = row + k / 3 - 1
        if _random(shape.seed, i, j) < shape.fill[1]:
            dx = x - float(i) - 0.2 - 0.6 * _random(shape.seed + 1, i, j)
            dy = y - float(j) - 0.2 - 0.6 * _random(shape.seed + 2, i, j)
            angle = 6.2832 * _random(shape.seed + 3, i, j)
            long = shape.fill[0] * (0.5 + _random(shape.seed + 4, i, j))
            along = (dx * wp.cos(angle) + dy * wp.sin(angle)) / long
            across = (dy * wp.cos(angle) - dx * wp.sin(angle)) / long
            if wp.abs(along) < 1.0 and wp.abs(across) < 0.4 * (1.0 - along * along):
                found = True
    return found


@wp.func
def _is_solid(shape: Shape, textures: wp.array3d(dtype=wp.vec3f), x: float, y: float) -> bool:
    """Say whether the mask of a sheet leaves the place (x, y) of the reference view standing."""
    rx = x - shape.centre[0]
    ry = y - shape.centre[1]
    u = rx * shape.axis[0] + ry * shape.axis[1]
    v = ry * shape.axis[0] - rx * shape.axis[1]
    a = u / shape.size[0]
    b = v / shape.size[1]
    if shape.mask == ELLIPSE:
        return a * a + b * b < 1.0
    if shape.mask == BLOB:
        angle = wp.atan2(b, a)
        radius = float(1.0)
        for k in range(2, 8):
            size = shape.fill[0] / wp.sqrt(float(k)) * (_random(shape.seed, k, 1) - 0.5)
            radius = radius + size * wp.cos(float(k) * angle + 6.2832 * _random(shape.seed, k, 2))
        return a * a + b * b < radius * wp.abs(radius)
    if shape.mask != WHOLE and (wp.abs(a) > 1.0 or wp.abs(b) > 1.0):
        return False
    if shape.mask == BARS:
        return _fraction(u / shape.period[0]) < shape.fill[0]
    if shape.mask == NET:
        return _fraction(u / shape.period[0]) < shape.fill[0] or _fraction(v / shape.period[1]) < shape.fill[1]
    if shape.mask == LEAVES:
        return _leaf(shape, u, v)
    if shape.mask == HOLES:
        return not _leaf(shape, u, v)
    if shape.mask == TORN:
        found = _sample(textures, shape.seed % _SMOOTH, u * shape.period[0], v * shape.period[0])
        return found[1] > shape.fill[0]
    return True


@wp.func
def _waves(shape: Shape, x: float, y: float) -> wp.vec3f:
    """Give the height of the relief of a sheet and its slopes."""
    height = wp.vec3f(0.0, 0.0, 0.0)
    size = shape.relief
    for k in range(3):
        fx = shape.waves[k, 0]
        fy = shape.waves[k, 1]
        phase = x * fx + y * fy + shape.waves[k, 2]
        slope = size * wp.cos(phase)
        height = height + wp.vec3f(size * wp.sin(phase), slope * fx, slope * fy)
        size = 0.45 * size
    return height


@wp.func
def _hit(shape: Shape, textures: wp.array3d(dtype=wp.vec3f), origin: wp.vec3f, ray: wp.vec3f) -> wp.vec2f:
    """Find the largest t for which origin + t ray lies on a primitive, _NOWHERE if none does, and the face of a box."""
    nothing = wp.vec2f(_NOWHERE, 0.0)
    r = origin - shape.centre
    height = r[2] - shape.slope[0] * r[0] - shape.slope[1] * r[1]
    rise = ray[2] - shape.slope[0] * ray[0] - shape.slope[1] * ray[1]
    if shape.kind == SHEET:
        if wp.abs(rise) < 0.03:
            return nothing
        t = -height / rise
        if shape.relief > 0.0:
            for _step in range(3):
                waves = _waves(shape, origin[0] + t * ray[0], origin[1] + t * ray[1])
                slope = rise - waves[1] * ray[0] - waves[2] * ray[1]
                if rise * slope < 0.05:
                    slope = 0.05 * wp.sign(rise)
                t = t - (height + t * rise - waves[0]) / slope
        if not _is_solid(shape, textures, origin[0] + t * ray[0], origin[1] + t * ray[1]):
            return nothing
        return wp.vec2f(t, 0.0)
    c = shape.axis[0]
    s = shape.axis[1]
    a = wp.vec3f(
        (r[0] * c + r[1] * s) / shape.size[0] + shape.tilt[0] * r[2],
        (r[1] * c - r[0] * s) / shape.size[1] + shape.tilt[1] * r[2],
        height / shape.size[2],
    )
    b = wp.vec3f(
        (ray[0] * c + ray[1] * s) / shape.size[0] + shape.tilt[0] * ray[2],
        (ray[1] * c - ray[0] * s) / shape.size[1] + shape.tilt[1] * ray[2],
        rise / shape.size[2],
    )
    if shape.kind == QUADRIC:
        k = shape.roundness
        square = b[0] * b[0] + k * b[1] * b[1] + b[2] * b[2]
        half = a[0] * b[0] + k * a[1] * b[1] + a[2] * b[2]
        rest = a[0] * a[0] + k * a[1] * a[1] + a[2] * a[2] - 1.0
        root = half * half - square * rest
        if root <= 0.0:
            return nothing
        t = (wp.sqrt(root) - half) / square
        if k < 0.5 and wp.abs(a[1] + t * b[1]) > 1.0:
            return nothing
        return wp.vec2f(t, 0.0)
    low = float(-1e8)
    high = float(1e8)
    face = float(0.0)
    for i in range(3):
        if wp.abs(b[i]) < 1e-9:
            if wp.abs(a[i]) > 1.0:
                return nothing
        else:
            t0 = (-1.0 - a[i]) / b[i]
            t1 = (1.0 - a[i]) / b[i]
            low = wp.max(low, wp.min(t0, t1))
            if wp.max(t0, t1) < high:
                high = wp.max(t0, t1)
                face = float(2 * i)
                if t1 > t0:
                    face = float(2 * i + 1)
    if high < low:
        return nothing
    return wp.vec2f(high, face)


@wp.func
def _nearest(
    shapes: wp.array2d(dtype=Shape),
    textures: wp.array3d(dtype=wp.vec3f),
    scene: int,
    x: float,
    y: float,
    offset: wp.vec2f,
) -> wp.vec3f:
    """Find disparity, number and face of the nearest primitive that a pixel sees; number -1 if it sees none."""
    best = wp.vec3f(_NOWHERE, -1.0, 0.0)
    origin = wp.vec3f(x, y, 0.0)
    ray = wp.vec3f(offset[0], offset[1], 1.0)
    for i in range(shapes.shape[1]):
        centre = shapes[scene, i].centre
        reach = shapes[scene, i].reach
        if centre[2] + reach[2] <= best[0]:  # those that follow are farther still
            break
        far_x = wp.abs(x + centre[2] * offset[0] - centre[0]) > reach[0] + reach[2] * wp.abs(offset[0])
        far_y = wp.abs(y + centre[2] * offset[1] - centre[1]) > reach[1] + reach[2] * wp.abs(offset[1])
        if not far_x and not far_y:
            found = _hit(shapes[scene, i], textures, origin, ray)
            if found[0] > best[0]:
                best = wp.vec3f(found[0], float(i), found[1])
    return best


@wp.func
def _is_lit(
    shapes: wp.array2d(dtype=Shape),
    textures: wp.array3d(dtype=wp.vec3f),
    scene: int,
    point: wp.vec3f,
    towards: wp.vec3f,
) -> bool:
    """Say whether no primitive stands between a point and the lamp."""
    start = point + wp.vec3f(0.0, 0.0, _APART)
    for i in range(shapes.shape[1]):
        centre = shapes[scene, i].centre
        reach = shapes[scene, i].reach
        if centre[2] + reach[2] < point[2]:
            break
        aside_x = wp.abs(point[0] + 0.5 * towards[0] - centre[0]) > reach[0] + 0.5 * wp.abs(towards[0])
        aside_y = wp.abs(point[1] + 0.5 * towards[1] - centre[1]) > reach[1] + 0.5 * wp.abs(towards[1])
        if reach[0] < 1e6 and not aside_x and not aside_y:
            found = _hit(shapes[scene, i], textures, start, towards)
            if found[0] > 0.02 and found[0] < 1.0:
                return False
    return True


@wp.func
def _pattern(look: Look, seed: int, u: float, v: float) -> float:
    """Give the share of the second colour that a pattern shows at a place on a surface."""
    a = u / look.cell[0]
    b = v / look.cell[1]
    if look.pattern == STRIPES:
        return wp.where(_fraction(a) < 0.5, 1.0, 0.0)
    if look.pattern == CHECKS:
        return wp.where((_fraction(a) < 0.5) != (_fraction(b) < 0.5), 1.0, 0.0)
    if look.pattern == BRICKS:
        row = wp.floor(b)
        along = a + 0.5 * (row - 2.0 * wp.floor(0.5 * row))
        if _fraction(along) < 0.06 or _fraction(b) < 0.1:
            return 1.0
        return 0.4 * _random(seed, int(wp.floor(along)), int(row))
    if look.pattern == DOTS:
        da = _fraction(a) - 0.5
        db = _fraction(b) - 0.5
        return wp.where(da * da + db * db < 0.09, 1.0, 0.0)
    if look.pattern == PATCHES:
        return _random(seed, int(wp.floor(a)), int(wp.floor(b)))
    return 0.0


@wp.func
def _colour(
    shape: Shape,
    look: Look,
    textures: wp.array3d(dtype=wp.vec3f),
    point: wp.vec3f,
    face: int,
    offset: wp.vec2f,
) -> wp.vec4f:
    """Give the colour of a point of a primitive as the view at `offset` shows it, and the light that falls on it."""
    r = point - shape.centre
    u = r[0] * shape.axis[0] + r[1] * shape.axis[1]
    v = r[1] * shape.axis[0] - r[0] * shape.axis[1]
    light = float(1.0)
    if shape.kind == SHEET:
        if shape.relief > 0.0:
            waves = _waves(shape, point[0], point[1])
            tilt = 6.0 * (waves[1] * look.shading[0] + waves[2] * look.shading[1])
            light = 1.0 + tilt / (1.0 + wp.abs(tilt))
    else:
        a = u / shape.size[0] + shape.tilt[0] * r[2]
        b = v / shape.size[1] + shape.tilt[1] * r[2]
        height = r[2] - shape.slope[0] * r[0] - shape.slope[1] * r[1]
        if shape.kind == QUADRIC:
            light = 1.0 + look.shading[0] * a + look.shading[1] * b * shape.roundness
            u = wp.asin(wp.clamp(a, -1.0, 1.0)) * shape.size[0]
            if shape.roundness > 0.5:
                v = wp.asin(wp.clamp(b, -1.0, 1.0)) * shape.size[1]
            else:
                v = b * shape.size[1]
        else:
            light = 1.0 + wp.length(look.shading) * (2.0 * _random(shape.seed, face, 5) - 1.0)
            u = a * shape.size[0]
            v = b * shape.size[1]
            if face < 2:
                u = height * 8.0
            elif face < 4:
                v = height * 8.0
            u = u + 41.0 * float(face)
    x = u * look.frame[0] + v * look.frame[1] + look.frame[2]
    y = v * look.frame[0] - u * look.frame[1] + look.frame[3]
    grain = _sample(textures, look.texture, x, y) - wp.vec3f(0.5, 0.5, 0.5)
    colour = look.colour + look.contrast * grain
    if look.pattern != PLAIN:
        share = look.strength * _pattern(look, shape.seed, u, v)
        colour = colour * (1.0 - share) + (look.second + 0.5 * look.contrast * grain) * share
    if look.mirror > 0.0:
        mx = (point[0] + (look.mirrored - point[2]) * offset[0]) * look.frame[0] * 0.5 + look.frame[3]
        my = (point[1] + (look.mirrored - point[2]) * offset[1]) * look.frame[0] * 0.15 + look.frame[2]
        seen = _sample(textures, (look.texture * 5 + 3) % textures.shape[0], mx, my)
        colour = colour * (1.0 - look.mirror) + seen * look.mirror
    if look.gloss > 0.0:
        gx = r[0] - look.spot[0] - look.drift[0] * offset[0]
        gy = r[1] - look.spot[1] - look.drift[1] * offset[1]
        shine = look.gloss * wp.exp(-(gx * gx + gy * gy) / (look.spot[2] * look.spot[2]))
        colour = colour + wp.vec3f(shine, shine, shine)
    return wp.vec4f(wp.max(colour[0], 0.0), wp.max(colour[1], 0.0), wp.max(colour[2], 0.0), wp.max(light, 0.1))


@wp.kernel(enable_backward=False)
def views_kernel(
    shapes: wp.array2d(dtype=Shape),
    looks: wp.array2d(dtype=Look),
    lights: wp.array(dtype=Light),
    textures: wp.array3d(dtype=wp.vec3f),
    offsets: wp.array(dtype=wp.vec2f),
    gains: wp.array2d(dtype=float),
    shifts: wp.array2d(dtype=wp.vec2f),
    rays: int,
    margin: int,
    seed: int,
    views_out: wp.array4d(dtype=wp.vec3f),
):
    """Make views [b, n, y, x] of scenes, intensities as a camera records them; pixel (0, 0) lies at (-margin, -margin).

    `offsets` [n] are those of the views, `gains` [b, n] factors on their light and `shifts` [b, n] how far they lie
    from where they should, in pixels. Each pixel is the mean of `rays` squared rays.
    """
    scene, n, y, x = wp.tid()
    light = lights[scene]
    height = views_out.shape[2]
    width = views_out.shape[3]
    state = wp.rand_init(seed, ((scene * views_out.shape[1] + n) * height + y) * width + x)
    total = wp.vec3f(0.0, 0.0, 0.0)
    side = float(rays)
    for k in range(rays * rays):
        jx = light.pixel * ((float(k % rays) + 0.5) / side - 0.5)
        jy = light.pixel * ((float(k / rays) + 0.5) / side - 0.5)
        lens = 2.0 * light.aperture * _spread(k, 0.5)
        offset = offsets[n] + lens
        px = float(x - margin) + jx + shifts[scene, n][0] - light.focus * lens[0]
        py = float(y - margin) + jy + shifts[scene, n][1] - light.focus * lens[1]
        found = _nearest(shapes, textures, scene, px, py, offset)
        if found[1] >= 0.0:
            i = int(found[1])
            point = wp.vec3f(px + found[0] * offset[0], py + found[0] * offset[1], found[0])
            seen = _colour(shapes[scene, i], looks[scene, i], textures, point, int(found[2]), offset)
            lit = seen[3]
            if light.shadow > 0.0:
                wide = light.radius * wp.length(light.direction) * _spread(k, 0.25)
                towards = light.direction + wp.vec3f(wide[0], wide[1], 0.0)
                if not _is_lit(shapes, textures, scene, point, towards):
                    lit = lit * (1.0 - light.shadow)
            if light.haze > 0.0:
                drawn = light.haze_scale * wp.vec2f(point[0] + 2.0 * point[2], point[1] - point[2])
                cloud = _sample(textures, 0, drawn[0], drawn[1])
                lit = lit * (1.0 - light.haze * wp.clamp(3.0 * (cloud[0] - 0.4), 0.0, 1.0))
            colour = wp.vec3f(seen[0], seen[1], seen[2])
            total = total + wp.cw_mul(colour, colour) * (lit + looks[scene, i].glow)
    total = total / (side * side)
    fx = (float(x - margin) / float(width - 2 * margin) - 0.5) * 2.0
    fy = (float(y - margin) / float(height - 2 * margin) - 0.5) * 2.0
    scale = light.exposure * gains[scene, n] * (1.0 - 0.5 * light.vignetting * (fx * fx + fy * fy))
    result = wp.vec3f(0.0, 0.0, 0.0)
    for c in range(3):
        value = wp.pow(wp.clamp(total[c] * scale, 0.0, 1.0), 1.0 / light.gamma)
        deviation = wp.sqrt(light.read * light.read + light.shot * light.shot * value)
        value = wp.clamp(value + deviation * wp.randn(state), 0.0, 1.0)
        result[c] = wp.round(value * light.levels) / light.levels
    views_out[scene, n, y, x] = result


@wp.kernel(enable_backward=False)
def truth_kernel(
    shapes: wp.array2d(dtype=Shape), textures: wp.array3d(dtype=wp.vec3f), truth_out: wp.array3d(dtype=float)
):
    """Find the disparity [b, y, x] at the centre of each pixel of the reference view, NaN where it sees nothing."""
    scene, y, x = wp.tid()
    found = _nearest(shapes, textures, scene, float(x), float(y), wp.vec2f(0.0, 0.0))
    truth_out[scene, y, x] = wp.where(found[1] >= 0.0, found[0], wp.nan)
