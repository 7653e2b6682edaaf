"""What usdchecker finds: every validator of USD's library, run on a stage in all its variants as they are selected."""
from pxr import Usd, UsdValidation


def complaints(path):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [f"{path.name}: {e.GetErrorAsString()}" for e in errors]
