"""What the checks of USD files share: the complaints of USD's validators, and the power of a lamp by the definitions of UsdLux."""
import math
from pxr import Usd, UsdLux, UsdValidation


def complaints(path):
    """What usdchecker finds in a file, its variants as they are selected."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [f"{path.name}: {e.GetErrorAsString()}" for e in errors]


def area(prim):
    """Luminous area of a rectangle, disk or sphere, m2."""
    if prim.IsA(UsdLux.RectLight):
        r = UsdLux.RectLight(prim)
        return r.GetWidthAttr().Get() * r.GetHeightAttr().Get()
    if prim.IsA(UsdLux.DiskLight):
        return math.pi * UsdLux.DiskLight(prim).GetRadiusAttr().Get() ** 2
    return 4 * math.pi * UsdLux.SphereLight(prim).GetRadiusAttr().Get() ** 2


def power(prim):
    """Power of a lamp, RGB."""
    light = UsdLux.LightAPI(prim)
    assert not light.GetNormalizeAttr().Get() and light.GetExposureAttr().Get() == 0
    return [math.pi * area(prim) * light.GetIntensityAttr().Get() * c for c in light.GetColorAttr().Get()]
