// English and Persian. What the service itself says (reasons, evidence) stays English, and is marked so.

const en = {
  live: "Live", runs: "Runs", compare: "Compare", library: "Calibration", discrepancies: "Discrepancies", ageing: "Ageing",
  navigation: "Pages", theme: "Theme", theme_auto: "auto", theme_light: "light", theme_dark: "dark", skip: "Skip to content",
  fit: "FIT", not_fit: "NOT FIT", stale: "STALE", working: "IN PROGRESS", no_run: "NO RUN", fault: "FAULT", held: "ON HOLD",
  fit_text: "Navigation data may be used.", not_fit_text: "Do not use the navigation data.",
  stale_silent: "The service does not answer: what you see is old. Do not rely on it.",
  stale_line: "No fresh frames from the block: what you see is old. Do not rely on it.",
  silent_for: "silent for {s} s", verdict: "Verdict", reasons: "Reasons", state: "State", path: "The way of the run",
  step_of: "Step {n} of {all}", remaining: "{time} left in this step", at_least: "at least {time} until READY", next: "Next: {step}",
  deciding: "as long as the block needs", start: "Start a run", abort: "Abort", acknowledge: "Acknowledge", cancel: "Cancel",
  start_text: "The block must stand still. The run settles, aligns, estimates in three stages and verifies.",
  method: "Method", operator: "Your name", reason: "Reason", azimuth: "Azimuth, deg (empty: as configured)", alignment: "Alignment",
  alignment_rest: "as configured", alignment_inertial: "inertial (the launcher sways)", abort_text: "Run {run} ends at once and must be begun anew.",
  acknowledge_fault: "Acknowledge the fault", acknowledge_text: "You have read the reason and dealt with it: {reason}",
  conditions: "Go / no-go conditions", measured: "measured", limit: "limit", since: "since", cause: "Cause", remedy: "Remedy", severity: "Severity",
  critical: "critical", warning: "warning", ok: "ok", failed: "FAILED", pending: "pending", unknown: "not known", acknowledged: "acknowledged",
  acknowledged_by: "Acknowledged by", acknowledge_condition: "A broken condition is never passed over silently: your name and reason stay in the record.",
  sensors: "Sensors, live", temperature: "temperature", accel: "accelerometer", gyro: "gyro", no_samples: "No samples yet.",
  terms: "Terms by stage", terms_text: "What is added to the readings. Whisker: 1σ. Band: what ageing explains (± {accel} mg, ± {gyro} deg/h).",
  no_terms: "No stage is complete yet.", sensor: "sensor", stage: "stage", final: "final",
  navigation_error: "Navigation error at rest", navigation_text: "After {t} s: {without} m without the terms, {with} m with them ({with95} m at 95 %).",
  without: "without", with_50: "with, 50 %", with_95: "with, 95 %", no_result: "Known once the run has a result.",
  line: "Line", age: "newest frame", counters: "Counters", log: "Events", when: "when", what: "what", why: "why",
  command: "Command", command_free: "Nobody holds the lease: any operator may command.", command_held: "{holder} commands for {s} s more.",
  command_mine: "You command.", take: "Take command", take_over: "Take over", give: "Give back",
  take_text: "Other consoles can then only watch.", take_over_text: "{holder} commands now. Taking over is recorded with your reason.",
  sign_in: "Sign in", sign_in_text: "This service asks for a token. `inertrim token create NAME` makes one.", token: "Token", sign_out: "Sign out",
  started: "started", ended: "ended", report: "Report", samples: "Samples (Parquet)", result: "result.json", older: "Older", none: "None.",
  run: "Run", transitions: "Changes of state", compare_text: "Choose two runs that have results.", first: "First", second: "Second",
  difference: "difference", in_sigma: "in σ", sigma: "1σ", verification: "verification χ²", calibrations: "Calibrations", models: "Block models and their lineage",
  name: "name", block: "block", hash: "SHA-256", unreadable: "cannot be read", parent: "made from", effects: "effects", date: "date",
  disc_text: "Compares recordings with what the block model predicts, and names what the model lacks.", disc_start: "Start on a run",
  in_use: "in use", disc_none: "No discrepancy search has been started.", disc_nothing: "There is no finished run and no recording in the library to search.", progress: "progress", adopt: "Adopt the model", adopt_text: "Later runs and simulations believe in this model.",
  not_there: "This service does not offer this page.", ageing_text: "Terms of every block since its calibration, with the forecast of when it leaves its limit.",
  confirm_done: "Done.", launcher: "launcher", signed_as: "signed in as", page_failed: "This could not be loaded: {why}", who: "operator", final_terms: "Final terms", circumstances: "Circumstances", checks: "checks", last_check: "last check", leaves: "leaves its limit", attention: "attention", months: "months since calibration",
};

const fa = {
  live: "زنده", runs: "اجراها", compare: "مقایسه", library: "کالیبراسیون", discrepancies: "ناسازگاری‌ها", ageing: "پیری",
  navigation: "صفحه‌ها", theme: "پوسته", theme_auto: "خودکار", theme_light: "روشن", theme_dark: "تیره", skip: "رفتن به محتوا",
  fit: "قابل استفاده", not_fit: "غیرقابل استفاده", stale: "کهنه", working: "در حال اجرا", no_run: "اجرایی نیست", fault: "خطا", held: "در انتظار",
  fit_text: "داده‌های ناوبری را می‌توان به کار برد.", not_fit_text: "داده‌های ناوبری را به کار نبرید.",
  stale_silent: "سرویس پاسخ نمی‌دهد: آنچه می‌بینید کهنه است. به آن اعتماد نکنید.",
  stale_line: "فریم تازه‌ای از بلوک نمی‌رسد: آنچه می‌بینید کهنه است. به آن اعتماد نکنید.",
  silent_for: "{s} ثانیه سکوت", verdict: "رأی", reasons: "دلیل‌ها", state: "حالت", path: "مسیر اجرا",
  step_of: "گام {n} از {all}", remaining: "{time} تا پایان این گام", at_least: "دست‌کم {time} تا READY", next: "بعدی: {step}",
  deciding: "تا وقتی بلوک نیاز دارد", start: "شروع اجرا", abort: "لغو", acknowledge: "تأیید", cancel: "انصراف",
  start_text: "بلوک باید بی‌حرکت باشد. اجرا پایدار می‌شود، تراز می‌شود، در سه مرحله برآورد و سپس راستی‌آزمایی می‌کند.",
  method: "روش", operator: "نام شما", reason: "دلیل", azimuth: "آزیموت، درجه (خالی: مطابق تنظیمات)", alignment: "ترازیابی",
  alignment_rest: "مطابق تنظیمات", alignment_inertial: "اینرسی (پرتابگر تاب می‌خورد)", abort_text: "اجرای {run} بی‌درنگ پایان می‌یابد و باید از نو آغاز شود.",
  acknowledge_fault: "تأیید خطا", acknowledge_text: "دلیل را خوانده و به آن رسیدگی کرده‌اید: {reason}",
  conditions: "شرط‌های برو / نرو", measured: "اندازه", limit: "حد", since: "از", cause: "علت", remedy: "چاره", severity: "شدت",
  critical: "بحرانی", warning: "هشدار", ok: "خوب", failed: "نقض", pending: "در آستانه", unknown: "نامعلوم", acknowledged: "پذیرفته",
  acknowledged_by: "پذیرنده", acknowledge_condition: "از شرط نقض‌شده بی‌صدا نمی‌گذریم: نام و دلیل شما ثبت می‌ماند.",
  sensors: "حسگرها، زنده", temperature: "دما", accel: "شتاب‌سنج", gyro: "ژیروسکوپ", no_samples: "هنوز نمونه‌ای نیست.",
  terms: "جمله‌ها به تفکیک مرحله", terms_text: "آنچه به خوانش‌ها افزوده می‌شود. خط: ۱σ. نوار: آنچه پیری توضیح می‌دهد (\u2066± {accel} mg\u2069، \u2066± {gyro} deg/h\u2069).",
  no_terms: "هنوز مرحله‌ای کامل نشده است.", sensor: "حسگر", stage: "مرحله", final: "نهایی",
  navigation_error: "خطای ناوبری در سکون", navigation_text: "پس از {t} ثانیه: {without} متر بدون جمله‌ها، {with} متر با آنها ({with95} متر در ۹۵٪).",
  without: "بدون", with_50: "با، ۵۰٪", with_95: "با، ۹۵٪", no_result: "وقتی اجرا نتیجه داشته باشد.",
  line: "خط", age: "تازه‌ترین فریم", counters: "شمارنده‌ها", log: "رویدادها", when: "کی", what: "چه", why: "چرا",
  command: "فرمان", command_free: "کسی فرمان را در دست ندارد: هر اپراتوری می‌تواند فرمان دهد.", command_held: "{holder} تا {s} ثانیهٔ دیگر فرمان می‌دهد.",
  command_mine: "فرمان با شماست.", take: "گرفتن فرمان", take_over: "گرفتن از دیگری", give: "پس دادن",
  take_text: "کنسول‌های دیگر فقط می‌توانند تماشا کنند.", take_over_text: "اکنون {holder} فرمان می‌دهد. گرفتن فرمان با دلیل شما ثبت می‌شود.",
  sign_in: "ورود", sign_in_text: "این سرویس توکن می‌خواهد. `inertrim token create NAME` یکی می‌سازد.", token: "توکن", sign_out: "خروج",
  started: "آغاز", ended: "پایان", report: "گزارش", samples: "نمونه‌ها (Parquet)", result: "result.json", older: "قدیمی‌تر", none: "هیچ.",
  run: "اجرا", transitions: "تغییر حالت‌ها", compare_text: "دو اجرای دارای نتیجه را برگزینید.", first: "نخست", second: "دوم",
  difference: "تفاوت", in_sigma: "بر حسب σ", sigma: "۱σ", verification: "χ² راستی‌آزمایی", calibrations: "کالیبراسیون‌ها", models: "مدل‌های بلوک و تبارشان",
  name: "نام", block: "بلوک", hash: "SHA-256", unreadable: "خواندنی نیست", parent: "ساخته از", effects: "اثرها", date: "تاریخ",
  disc_text: "ضبط‌ها را با پیش‌بینی مدل بلوک می‌سنجد و کمبود مدل را نام می‌برد.", disc_start: "آغاز بر یک اجرا",
  in_use: "در حال استفاده", disc_none: "جست‌وجویی آغاز نشده است.", disc_nothing: "هیچ اجرای پایان‌یافته و هیچ ضبطی در کتابخانه نیست.", progress: "پیشرفت", adopt: "پذیرش مدل", adopt_text: "اجراها و شبیه‌سازی‌های بعدی این مدل را باور می‌کنند.",
  not_there: "این سرویس این صفحه را ندارد.", ageing_text: "جمله‌های هر بلوک از زمان کالیبراسیون، با پیش‌بینی زمان گذر از حد.",
  confirm_done: "انجام شد.", launcher: "پرتابگر", signed_as: "وارد شده به نام", page_failed: "بار نشد: {why}", who: "اپراتور", final_terms: "جمله‌های نهایی", circumstances: "شرایط", checks: "بازبینی‌ها", last_check: "آخرین بازبینی", leaves: "گذر از حد", attention: "توجه", months: "ماه پس از کالیبراسیون",
};

const STATES = {
  OFFLINE: "آفلاین", POWER_UP: "روشن شدن", SELF_TEST: "خودآزمایی", SETTLING: "پایدار شدن", ALIGNING: "ترازیابی", STAGE_1: "مرحلهٔ ۱",
  STAGE_2: "مرحلهٔ ۲", STAGE_3: "مرحلهٔ ۳", VERIFYING: "راستی‌آزمایی", READY: "آماده", HOLD: "انتظار", FAULT: "خطا", ABORTED: "لغو شده",
};

const CONDITIONS = {
  frames_fresh: ["فریم‌ها تازه‌اند", "خط قطع است، بلوک برق ندارد، نرخ بیت نادرست است یا میزبان فرصت خواندن ندارد.", "کابل و برق را ببینید؛ `inertrim detect` می‌گوید روی خط چیست."],
  settled: ["پایدار شده", "بلوک گرم نشده، یا پس از نتیجه گرم یا سرد شده است.", "صبر کنید؛ آفتاب و باد را دور کنید. پس از READY اجرای تازه آغاز کنید."],
  still: ["بلوک بی‌حرکت است", "باد، افراد یا ماشین‌ها پرتابگر را تکان می‌دهند.", "علت را بیابید؛ پرتابگری که تاب می‌خورد با ترازیابی اینرسی تراز می‌شود."],
  temperature_in_range: ["دما در بازهٔ کالیبراسیون", "هوا سردتر یا گرم‌تر از کالیبراسیون است.", "بلوک را گرم یا سایه کنید، یا آگاهانه بپذیرید."],
  calibration_age: ["کالیبراسیون تازه است", "کالیبراسیون آزمایشگاه از مهلتش گذشته یا تاریخ آینده دارد.", "بلوک را دوباره کالیبره کنید؛ تاریخ میزبان را ببینید."],
  terms_expected: ["جمله‌ها در حد پیری", "بلوک بیش از اثر انبارش تغییر کرده: ضربه، آسیب یا پروندهٔ کالیبراسیون نادرست.", "ببینید کالیبراسیون از همین بلوک است؛ بلوک را بررسی کنید."],
  verification: ["راستی‌آزمایی بر دادهٔ تازه", "ناوبری با جمله‌ها بیش از پیش‌بینی کوواریانس خطا دارد.", "مرجع و محل را ببینید، خطا را تأیید و دوباره اجرا کنید."],
  validity: ["نتیجه معتبر است", "زمانش گذشته یا رخدادی آن را باطل کرده است.", "اجرای تازه آغاز کنید."],
  clock: ["ساعت میزبان پایدار است", "ساعت میزبان در حین کار تنظیم شده است.", "هم‌زمانی ساعت را ببینید و سرویس را از نو راه بیندازید."],
  disk_space: ["دیسک جا دارد", "دیسک پر می‌شود.", "اجراهای کهنه را جابه‌جا کنید."],
  sample_rate: ["نرخ نمونه درست است", "ساعت بلوک نادرست است یا نرخ آن نیست که می‌گوید.", "نرخ را در تنظیمات درست کنید؛ ساعت بلوک را بررسی کنید."],
};

const WORDS = { en, fa };
export const i18n = { language: localStorage.getItem("inertrim.language") === "fa" ? "fa" : "en" };

export function t(key, facts = {}) {
  const text = WORDS[i18n.language][key] ?? en[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => facts[name] ?? "");
}

export const stateName = (state) => (i18n.language === "fa" ? STATES[state] ?? state : state.replace("_", " "));

export function conditionWords(one) {
  const own = i18n.language === "fa" ? CONDITIONS[one.name] : null;
  return own ? { title: own[0], cause: own[1], remedy: own[2], own: true } : { title: one.title, cause: one.cause, remedy: one.remedy, own: i18n.language === "en" };
}

export function speak(language) {
  i18n.language = language;
  localStorage.setItem("inertrim.language", language);
  document.documentElement.lang = language;
  document.documentElement.dir = language === "fa" ? "rtl" : "ltr";
  document.getElementById("skip").textContent = t("skip");
}
