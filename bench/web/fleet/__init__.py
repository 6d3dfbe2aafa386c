"""Many benches on one page: what each of them tells of its runs, who hears it, and the page that shows them."""
