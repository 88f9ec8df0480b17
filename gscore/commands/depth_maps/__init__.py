"""Work of `gscore depth`: depth maps predicted, aligned and reported."""
