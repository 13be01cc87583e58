from .cache import use_writable_folder

use_writable_folder()
